"""The same words twice: the same bytes, pages included; whatever the clock does, and though the machine slept.

Fails where something is drawn from a generator without a seed, where a page says when it was drawn, and where a clock
that can be set decides anything.
"""

import hashlib
import itertools
import json
import os
import signal
import subprocess
import sys
import time

import pytest

from tests.train.short import ascent, refinement

pytestmark = pytest.mark.soak

MAIN = [sys.executable, "-m", "racerl.cli"]
SMOKE = ["budget=smoke", "threads=1", "+dr=friction_0.02"]
COMMANDS = [
    ["record", "drive=programme", "seconds=60", "vehicle=published", "+vehicle/effect=yaw_damping", "out=log"],
    ["data", "log/log.parquet", "out=data"],
    ["train", *SMOKE, "out=trained"],
    ["train", "from=trained", "budget=smoke", "threads=1", refinement(), "out=refined"],
    ["train", "from=trained", "budget=smoke", "threads=1", ascent(), "out=ascended"],
    ["evaluate", "trained", "laps=2", "seeds=[0,1]", "car=twin", "out=raced"],
    ["evaluate", "controller=mpc", "laps=1", "seeds=[0]", "out=mpc"],
    ["optimum", "track=oval", "out=optimum"],
    ["track", "l_shape", "out=track"],
    ["identify", "log/log.parquet", "starts=1", "folds=2", "threads=2", "out=identified"],
    ["gap", "log/log.parquet", "vehicle=published", "threads=2", "out=gap"],
    ["tune", "pure_pursuit", "trials=3", "laps=1", "seeds=[0]", "out=tuned"],
    ["report", "mpc", "out=report"],  # of a training it says how long that took
]
CLOCK = {"seconds", "started", "finished", "run_id", "train_run_id", "clean_after_s"}
CODE = """
import itertools, sys, time
jumps = itertools.cycle([0.0, 86400.0, -86400.0, 3.0e7, -3.0e7])
real, real_ns = time.time, time.time_ns
time.time, time.time_ns = lambda: real() + next(jumps), lambda: real_ns() + int(1e9 * next(jumps))
from racerl.train import session
session.CHECKPOINT_PERIOD = 0.2
from racerl.cli import main
main()
"""


def run(command, folder, words):
    done = subprocess.run([*command, *words], cwd=folder, capture_output=True, text=True, timeout=900)
    assert done.returncode == 0, done.stdout + done.stderr
    return done


def content(path):
    """Return what of a file must come again: all of it, but for the clock's numbers."""
    if path.suffix == ".json":
        return json.dumps(timeless(json.loads(path.read_text())), sort_keys=True)
    if path.suffix == ".jsonl":
        return json.dumps([timeless(json.loads(line)) for line in path.read_text().splitlines()])
    return hashlib.sha256(path.read_bytes()).hexdigest()


def timeless(document):
    if isinstance(document, dict):
        kept = {key: timeless(value) for key, value in document.items() if key not in CLOCK}
        return {key: value for key, value in kept.items() if not key.startswith("time/")}
    return [timeless(each) for each in document] if isinstance(document, list) else document


def contents(folder):
    files = (path for path in folder.rglob("*") if path.is_file() and "tensorboard" not in path.parts)
    return {str(path.relative_to(folder)): content(path) for path in files}


def test_every_command_twice(tmp_path, capsys):
    for name in ("one", "other"):
        (tmp_path / name).mkdir()
        for words in COMMANDS:
            run(MAIN, tmp_path / name, words)
    one, other = contents(tmp_path / "one"), contents(tmp_path / "other")
    assert one.keys() == other.keys()
    unlike = [file for file in one if one[file] != other[file]]
    with capsys.disabled():
        print(f"\ntwice: {len(COMMANDS)} commands, {len(one)} files, {len(unlike)} unlike {unlike}")
    assert not unlike


def trained(folder, command, during=lambda job: None):
    folder.mkdir()
    words = ["train", *SMOKE, "budget.steps=120000", "budget.final_std=0.1", "out=run"]
    job = subprocess.Popen([*command, *words], cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    during(job)
    said = job.communicate(timeout=600)[0].decode()
    assert job.returncode == 0, said
    return (folder / "run" / "policy.safetensors").read_bytes(), json.loads(
        (folder / "run" / "manifest.json").read_text()
    )


def test_a_clock_that_jumps_and_a_machine_that_sleeps(tmp_path):
    weights, _ = trained(tmp_path / "plain", MAIN)
    jumped, manifest = trained(tmp_path / "jumped", [sys.executable, "-c", CODE])
    assert jumped == weights and 0.0 < manifest["seconds"] < 300.0

    def sleep(job):
        for _ in itertools.repeat(None, 4):
            time.sleep(2.0)
            os.kill(job.pid, signal.SIGSTOP)
            time.sleep(1.0)
            os.kill(job.pid, signal.SIGCONT)

    assert trained(tmp_path / "slept", MAIN, sleep)[0] == weights


def test_two_writers_leave_one_result(tmp_path):
    (tmp_path / "a").mkdir()
    words = ["train", *SMOKE, "budget.steps=60000", "out=run"]
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    jobs = [subprocess.Popen([*MAIN, *words], cwd=tmp_path / "a", **streams) for _ in range(3)]
    said = [job.communicate(timeout=600) for job in jobs]
    codes = sorted(job.returncode for job in jobs)
    assert codes == [0, 2, 2], said
    refused = [errors for job, (_, errors) in zip(jobs, said, strict=True) if job.returncode]
    told = ("another train is at work in it", "already holds this very run")
    assert all(any(line in errors for line in told) for errors in refused)
