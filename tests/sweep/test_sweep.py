"""The sweep as users run it: processes, locks, failures, and a plug that is pulled."""

import dataclasses
import json
import os
import random
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import pytest

from racerl.config import compose_settings, gather_words
from racerl.documents import conf_folder
from racerl.errors import RacerlError
from racerl.sweep import engine
from racerl.sweep.definition import read_sweeps
from racerl.sweep.engine import STOPS, Engine, Slot
from racerl.sweep.jobs import plan
from racerl.sweep.sweep import sweep as stage
from racerl.sweep.work import STOPPED

ARMS = {"a": ["dr=none"], "b": ["sim=no_actuators"]}
CLAIM = "{metric: turn_in, contrast: {a: 1, b: -1}, above: 0}"
SMALL = ["budget=smoke", "laps=1", "starts=[0]"]


@pytest.fixture
def place(tmp_path):
    """A folder with a sweep of its own."""
    (tmp_path / "sweeps").mkdir()
    arms = "\n".join(f"  {name}: {json.dumps(words)}" for name, words in ARMS.items())
    (tmp_path / "sweeps" / "mine.yaml").write_text(
        f"question: Which?\nbase: []\narms:\n{arms}\n  c: [dr=none]\nseeds: [0]\nmetrics: [lap_time, turn_in]\n"
        f"claims:\n  7:\n    says: a is earlier.\n    tests: [{CLAIM}]\n"
    )
    return tmp_path


def start(place, *words):
    command = [sys.executable, "-m", "racerl.cli", "sweep", "mine", *SMALL, *words]
    return subprocess.Popen(command, cwd=place, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def sweep(place, *words):
    process = start(place, *words)
    out, error = process.communicate(timeout=300)
    return process.returncode, out, error


def at_work(out):
    """Return the processes that work on jobs of a sweep's folder."""
    found = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            words = path.read_bytes().decode(errors="replace").split("\0")
        except OSError:
            continue
        if any("submitit" in word for word in words) and any(word.startswith(str(out)) for word in words):
            found.append(int(path.parent.name))
    return found


def wait_for(condition, seconds=60.0):
    until = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < until
        time.sleep(0.1)


def trained(out, lines):
    """Return whether a training has come so far."""
    return any(log.read_text().count("\n") >= lines for log in out.glob("jobs/*/train/progress.jsonl"))


def results(out):
    """Return the bytes of everything that must repeat."""
    weights = {path.parent.parent.name: path.read_bytes() for path in out.glob("jobs/*/train/policy.safetensors")}
    names = ("laps.csv", "learning.csv", "trainings.csv", "results.json", "report.html")
    return weights | {name: (out / name).read_bytes() for name in names}


@pytest.mark.slow
def test_a_sweep_goes_on_where_the_plug_was_pulled_and_trains_shared_arms_once(place, run):
    out = place / "once"
    first = start(place, "out=once")
    wait_for(lambda: len(at_work(out)) > 0)
    beside = run("sweep", "mine", *SMALL, "out=once")
    assert beside.returncode == 2 and "another sweep is at work" in beside.stderr and beside.stderr.count("\n") == 1
    first.kill()
    first.wait()
    wait_for(lambda: not at_work(out), 15.0)
    done = run("sweep", "mine", *SMALL, "out=once")
    printed = done.stdout
    assert done.returncode == 0 and "claim 7" in printed and "report in once/report.html" in printed
    assert len(list((out / "jobs").iterdir())) == 2  # c is a
    facts = json.loads((out / "results.json").read_text())
    assert "Trial budget" in printed and "claim 7: no verdict" in printed and facts["trial_steps"] == 2048
    assert [claim["verdict"] for claim in facts["claims"]] == [None] and "<h1>A trial" in (
        out / "report.html"
    ).read_text()
    assert facts["jobs"] == {"planned": 2, "done": 2} and {row["arm"] for row in facts["arms"]} == {"a", "b", "c"}
    assert {row["car"] for row in facts["arms"]} == {"model", "twin"}
    manifest = json.loads((out / "jobs").glob("a-0-*").__next__().joinpath("train/manifest.json").read_text())
    assert manifest["threads"] == 1 and not (out / ".submitit").exists()
    before, written = results(out), {path: path.stat().st_mtime for path in out.glob("jobs/*/*/manifest.json")}
    assert run("sweep", "mine", *SMALL, "out=once").returncode == 0 and results(out) == before
    assert {path: path.stat().st_mtime for path in out.glob("jobs/*/*/manifest.json")} == written
    more = run("sweep", "mine", *SMALL, "seeds=[0,1]", "also=[once]", "out=twice")
    assert more.returncode == 0 and {path.name[:4] for path in (place / "twice" / "jobs").iterdir()} == {"a-1-", "b-1-"}
    both = json.loads((place / "twice" / "results.json").read_text())
    assert both["jobs"] == {"planned": 4, "done": 4} and both["also"][0]["jobs"] == 2
    assert {row["trainings"] for row in both["arms"]} == {2}
    other = run("sweep", "mine", *SMALL, "out=once", "laps=2")
    assert other.returncode == 2 and "already holds another sweep" in other.stderr and other.stderr.count("\n") == 1


def test_jobs_of_a_killed_sweep_keep_their_work_and_end(place):
    """Checkpoints are half a minute apart: this one is written since the sweep is gone."""
    out = place / "killed"
    first = start(place, f"out={out}", "budget.steps=2000000", "engine.jobs=1", "cars=[model]")
    wait_for(partial(trained, out, 3))
    assert not list(out.glob("jobs/*/train/checkpoint.safetensors"))
    first.kill()
    first.wait()
    wait_for(lambda: not at_work(out), 10.0)
    assert len(list(out.glob("jobs/*/train/checkpoint.safetensors"))) == 1


def test_arms_of_the_same_name_and_other_words_are_jobs_of_their_own(tmp_path):
    base = read_sweeps("action_space")[0]
    arms = ({"a": ("obs=geometric",)}, {"a": ("obs=progress",)})
    sweeps = [dataclasses.replace(base, name=f"s{i}", arms=each, seeds=(0,)) for i, each in enumerate(arms)]
    settings = {"words": ["budget=smoke"], "threads": 1, "seeds": [], "laps": 1, "starts": [0], "cars": ["model"]}
    planned = plan(sweeps, settings, tmp_path, compose_settings)
    assert len({job.name for job in planned.jobs}) == len({job.path for job in planned.jobs}) == 2
    assert planned.of["s0", "a", 0] is not planned.of["s1", "a", 0]


@pytest.mark.slow
def test_another_content_of_a_file_is_another_job(tmp_path):
    text = (conf_folder() / "vehicle" / "published.yaml").read_text()
    settings = {**compose_settings("sweep", ["name=actuator_model", "seeds=[0]", "cars=[model]"]), "laps": 1}
    settings |= {"words": [f"vehicle={tmp_path / 'mine.yaml'}", "budget=smoke"]}
    names = []
    for mass in ("5.1", "5.2", "5.1"):
        (tmp_path / "mine.yaml").write_text(text.replace("mass: 5.1 ", f"mass: {mass} "))
        made = plan(read_sweeps("actuator_model"), settings, tmp_path, compose_settings)
        names.append(sorted(job.path.name for job in made.jobs))
    assert names[0] == names[2] and not set(names[0]) & set(names[1])


@pytest.mark.slow
def test_a_job_that_fails_takes_no_other_along(place, run):
    out = place / "failing"
    words = [f"out={out}", "engine.jobs=1", "engine.retries=0", "cars=[model]"]
    started = start(place, *words)
    wait_for(lambda: (out / "jobs").is_dir() and any((out / "jobs").glob("a-0-*/state.json")))
    for process in at_work(out):
        if "submitit.core" in Path(f"/proc/{process}/cmdline").read_text():
            os.kill(process, signal.SIGKILL)
    _, error = started.communicate(timeout=300)
    assert started.returncode == 2 and "1 of 2 jobs failed" in error and error.count("\n") == 1
    facts = json.loads((out / "results.json").read_text())
    assert list(facts["failed"]) == ["a-0"] and {row["arm"] for row in facts["arms"]} == {"b"}
    assert "a-0 failed" in (out / "report.html").read_text()
    again = run("sweep", "mine", *SMALL, *words)
    assert again.returncode == 0, again.stderr  # tried again
    assert json.loads((out / "results.json").read_text())["failed"] == {}


@pytest.mark.parametrize(
    ("stopped", "retries", "submitted", "failed"),
    [(3, 0, 4, 0), (0, 0, 1, 1), (0, 2, 3, 1), (10_000, 0, STOPS + 1, 1)],
)
def test_only_what_was_not_asked_to_end_is_a_failed_try(tmp_path, monkeypatch, stopped, retries, submitted, failed):
    job, made = SimpleNamespace(name="a", path=tmp_path / "a", done=False), []
    job.path.mkdir()

    def submit(self, job):
        made.append(job)
        if len(made) <= stopped:
            (job.path / STOPPED).touch()
        job.done = stopped > 0 and len(made) == stopped + 1
        handle = SimpleNamespace(done=lambda: True, stdout=lambda: "", cancel=lambda: None)
        return Slot(job, handle, tmp_path / "pickles")

    monkeypatch.setattr(Engine, "_submit", submit)
    monkeypatch.setattr(engine, "PERIOD", {"local": 0.0})
    found = Engine({"name": "local", "jobs": 1, "retries": retries}, 1, tmp_path).run([job])
    assert (len(made), len(found)) == (submitted, failed)


@pytest.mark.slow
def test_a_job_that_is_asked_to_end_has_not_failed(place):
    out = place / "asked"
    started = start(place, f"out={out}", "engine.jobs=1", "engine.retries=0", "cars=[model]", "budget.steps=40000")
    wait_for(partial(trained, out, 3))
    for process in at_work(out):
        os.kill(process, signal.SIGTERM)
    _, error = started.communicate(timeout=300)
    assert started.returncode == 0, error
    assert json.loads((out / "results.json").read_text())["failed"] == {}


@pytest.mark.parametrize(
    "words, said",
    [
        (["threads=0"], "threads = 0"),
        (["engine=cloud"], "unknown engine 'cloud'"),
        (["engine.jobs=0"], "engine.jobs = 0"),
        (["words=['seed=1']"], "a sweep has several; give seeds="),
        (["starts=[]"], "starts = .*one at least"),
        (["engine.retries=-1"], "engine.retries = -1"),
        (["seeds=[x]"], "seeds = x"),
        (["cars=[truck]"], "unknown car 'truck'"),
        (["words=['dr=icy']"], "unknown dr 'icy'"),
        (["laps=many"], "laps = many"),
        (["also=once"], "also = once"),
        (["also=[once]"], "once: is no racerl run folder"),
        (["name=minr"], "unknown sweep 'minr'.*mine"),
    ],
)
def test_a_mistake_is_told_and_leaves_nothing(place, monkeypatch, words, said):
    monkeypatch.chdir(place)
    with pytest.raises(RacerlError, match=said):
        stage(compose_settings("sweep", ["name=mine", *words]), place / "none", compose_settings)
    assert not (place / "none").exists()


def test_words_that_are_no_own_keys_are_those_of_training():
    given = ["mine", "budget=smoke", "+dr=none", "engine.jobs=2", "laps=3", "vehicle.friction=0.7", "-m"]
    words = gather_words("sweep", given, "words")
    assert words == [
        "mine",
        "engine.jobs=2",
        "laps=3",
        "-m",
        "words=['budget=smoke','+dr=none','vehicle.friction=0.7']",
    ]


@pytest.fixture
def cluster(tmp_path_factory, monkeypatch):
    """A real Slurm of one node, with a partition whose jobs preempt the others'."""
    script, folder = Path(__file__).with_name("slurm.sh"), tmp_path_factory.mktemp("slurm")
    up = subprocess.run([script, "start", folder], capture_output=True, text=True, timeout=300)
    assert up.returncode == 0, up.stderr
    for word in up.stdout.split()[1:]:
        name, _, value = word.partition("=")
        monkeypatch.setenv(name, os.path.expandvars(value))
    yield
    subprocess.run([script, "stop", folder], check=True)


@pytest.mark.slurm
def test_the_same_on_a_real_slurm_where_a_job_is_cancelled(place, cluster):
    there, here = place / "there" / "run", place / "here" / "run"  # one name, for the page tells it
    started = start(place, f"out={there}", "engine=slurm")
    wait_for(lambda: any(there.glob("jobs/a-0-*/state.json")))
    queued = subprocess.run(["squeue", "-h", "-o", "%A"], capture_output=True, text=True, check=True).stdout.split()
    subprocess.run(["scancel", queued[0]], check=True)  # is tried again
    _, error = started.communicate(timeout=300)
    assert started.returncode == 0, error
    assert sweep(place, f"out={here}")[0] == 0
    assert results(there) == results(here)


@pytest.mark.slurm
def test_a_job_that_is_preempted_keeps_its_work_ends_and_goes_on(place, cluster):
    """Twice, though a job that fails is tried again once only; checkpoints are half a minute apart."""
    there, here = place / "there" / "run", place / "here" / "run"
    words = ("budget.steps=120000", "cars=[model]", "engine.jobs=1")
    started = start(place, f"out={there}", "engine=slurm", *words)
    for lines in (3, 6):
        wait_for(partial(trained, there, lines))
        subprocess.run(["sbatch", "-p", "urgent", "--exclusive", "-o", "/dev/null", "--wrap", "sleep 1"], check=True)
        wait_for(lambda: not at_work(there), 10.0)
        assert len(list(there.glob("jobs/*/train/checkpoint.safetensors"))) == 1
        wait_for(lambda: at_work(there), 120.0)
    _, error = started.communicate(timeout=300)
    assert started.returncode == 0, error
    assert sweep(place, f"out={here}", *words)[0] == 0
    assert results(there) == results(here)


@pytest.mark.slow
def test_killed_at_random_it_comes_to_the_same(place):
    words = ("seeds=[0,1]", "budget.steps=40000")
    assert sweep(place, "out=calm/run", *words)[0] == 0
    out, dice = place / "stormy" / "run", random.Random(3)  # noqa: S311 - one name, for the page tells it
    for _ in range(12):
        process = start(place, f"out={out}", *words)
        try:
            process.wait(timeout=dice.uniform(4.0, 14.0))
            break
        except subprocess.TimeoutExpired:
            jobs = at_work(out)
            victim = dice.choice([process.pid, *jobs])
            os.kill(victim, signal.SIGKILL)
            if victim != process.pid:
                time.sleep(1.0)
                process.kill()
            process.wait()
            wait_for(lambda: not at_work(out), 15.0)
    else:
        assert sweep(place, f"out={out}", *words)[0] == 0
    assert process.returncode in (0, -9)
    assert sweep(place, f"out={out}", *words)[0] == 0
    calm, stormy = results(place / "calm" / "run"), results(out)
    assert {name for name in calm if calm[name] != stormy[name]} == set()
