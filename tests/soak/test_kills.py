"""Commands killed at random and given again: what they leave is what an undisturbed one leaves, byte for byte.

Every case is run undisturbed once; then, in folders of their own, runs of the same words are killed by SIGKILL one to
three times each, after random times, and finished. Fails where the checkpoint of a training is no longer written or
read (imitation without `recover`, PPO without its progress), where a gap's parts are not kept, where a run killed
while its manifest is written is refused, and where jobs of a killed sweep live on.
"""

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from racerl.rerun import compare
from racerl.run import is_complete
from tests.train.short import ascent, refinement

pytestmark = pytest.mark.soak

PERIOD = 0.5  # s between checkpoints, for trainings of seconds
MAIN = f"""
import sys
from racerl.train import session
session.CHECKPOINT_PERIOD = {PERIOD}
from racerl.cli import main
main()
"""
REFINED = refinement(generations=60, evaluations=6, pairs=32, horizon=40, episode=80)
ASCENDED = ascent(updates=60, evaluations=6, horizon=40, episode=80)
PPO = ["budget=smoke", "threads=1", "+dr=friction_0.02", "budget.final_std=0.1", "budget.normalise=true"]
SHORT = ["algo.rounds=12", "algo.cars=64", "algo.updates=60", "algo.last_updates=200"]
CASES = {  # words, and how many kills
    "PPO refined": (["train", *PPO, "budget.steps=120000", "budget.evaluations=10", REFINED], 30),
    "PPO ascended": (["train", *PPO, "budget.steps=60000", "budget.evaluations=10", ASCENDED], 20),
    "imitation": (["train", "algo=imitation", "threads=1", *SHORT, "budget=unrefined"], 10),
    "sweep": (["sweep", "actuator_model", *PPO, "budget.steps=20000", "seeds=[0]", "cars=[model]", "threads=1"], 20),
    "gap": (["gap", "../log.parquet", "vehicle=published", "threads=1"], 20),
    "identify": (["identify", "../log.parquet", "starts=1", "folds=2", "threads=1"], 15),
    "evaluate": (["evaluate", "../trained", "laps=20", "car=twin"], 12),
    "record": (["record", "seconds=300", "vehicle=published", "drive=race"], 20),
}
LOG = ["record", "drive=programme", "seconds=90", "vehicle=published", "out=recorded", "+vehicle/effect=yaw_damping"]
CHECKPOINTS = ("checkpoint.safetensors", "refinement.safetensors")
SEED = 20261126


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """Return a folder with a log and a training in it."""
    folder = tmp_path_factory.mktemp("kills")
    finish(LOG, folder)
    (folder / "recorded" / "log.parquet").rename(folder / "log.parquet")
    finish(["train", *PPO, "out=trained"], folder)
    return folder


def start(words, folder):
    folder.mkdir(exist_ok=True)
    command = [sys.executable, "-c", MAIN, *words]
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
    return subprocess.Popen(command, cwd=folder, start_new_session=True, **streams)


def finish(words, folder):
    """Run a command to its end; return the seconds."""
    began = time.monotonic()
    job = start(words, folder)
    said = job.communicate(timeout=900)[0].decode()
    assert job.returncode == 0, said
    return time.monotonic() - began


def at_work(folder):
    """Return the processes that work in a folder."""
    found = []
    for each in Path("/proc").glob("[0-9]*"):
        try:
            if (each / "cwd").readlink().is_relative_to(folder):
                found.append(each.name)
        except OSError:
            continue
    return found


def behind(run):
    """Return the seconds of a training's log that its last checkpoint lacks, 0 where it has neither."""
    kept = [path.stat().st_mtime for path in run.glob("*.safetensors") if path.name in CHECKPOINTS]
    log = run / "progress.jsonl"
    return max(0.0, log.stat().st_mtime - max(kept)) if kept and log.exists() else 0.0


@pytest.mark.parametrize("name", list(CASES))
def test_killed_and_given_again(name, place, capsys):
    words, most = CASES[name]
    words = [*words, "out=run"]
    whole = place / f"{name} undisturbed".replace(" ", "_")
    seconds = finish(words, whole)
    dice, kills, runs, late = np.random.default_rng(SEED), 0, 0, 0.0
    while kills < most:
        folder = place / f"{name} {runs}".replace(" ", "_")
        for _ in range(dice.integers(1, 4)):
            job = start(words, folder)
            try:
                job.wait(dice.uniform(0.15, 1.0) * seconds)
            except subprocess.TimeoutExpired:
                os.kill(job.pid, signal.SIGKILL)
                job.wait()
                kills += 1
                late = max(late, behind(folder / "run"))
            else:
                break  # done before it could be killed
            deadline = time.monotonic() + 10.0
            while (left := at_work(folder)) and time.monotonic() < deadline:
                time.sleep(0.2)
            assert not left, f"{name}: processes {left} live on"
        if not is_complete(folder / "run"):
            finish(words, folder)
        differences = compare(whole / "run", folder / "run")
        assert not differences, f"{name}, run {runs}: {differences}"
        assert not [path for path in (folder / "run").rglob("*") if path.name.endswith(".tmp")]
        runs += 1
    with capsys.disabled():
        print(
            f"\n{name}: {kills} kills in {runs} runs of {seconds:.0f} s, all as undisturbed; {late:.1f} s lost at most"
        )
    assert late < PERIOD + 3.0


def listens(process):
    """Return whether a process has a handler of its own for SIGTERM, as it has from its first words on."""
    try:
        lines = Path(f"/proc/{process}/status").read_text().splitlines()
    except OSError:
        return False
    caught = next(int(line.split()[1], 16) for line in lines if line.startswith("SigCgt"))
    return bool(caught >> (signal.SIGTERM - 1) & 1)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
@pytest.mark.parametrize("name", list(CASES))
def test_asked_to_stop_it_ends_soon_and_says_how_to_go_on(name, number, place, capsys):
    words, _ = CASES[name]
    folder, dice, times = place / f"{name} {int(number)}".replace(" ", "_"), np.random.default_rng(SEED), []
    while len(times) < 3:
        if is_complete(folder / "run"):  # done before it was asked, or before it had to end
            shutil.rmtree(folder / "run")
        job = start([*words, "out=run"], folder)
        until = time.monotonic() + 60.0
        while not listens(job.pid) and time.monotonic() < until and job.poll() is None:
            time.sleep(0.1)
        try:
            job.wait(dice.uniform(0.2, 9.0))
        except subprocess.TimeoutExpired:
            os.killpg(job.pid, number) if number == signal.SIGINT else job.send_signal(number)
        else:
            continue
        asked = time.monotonic()
        said = job.communicate(timeout=60)[0].decode()
        while at_work(folder) and time.monotonic() - asked < 60.0:
            time.sleep(0.1)
        times.append(time.monotonic() - asked)
        assert times[-1] < 10.0, f"{name}: {times[-1]:.1f} s"
        if is_complete(folder / "run"):
            continue  # it was done by then
        # nothing is said where nothing had begun
        assert "Traceback" not in said and ("the same command" in said or not said.strip()), said
        assert job.returncode == 128 + number
    with capsys.disabled():
        print(f"\n{name}, {number.name}: ended after {max(times):.1f} s at most")
