"""The train stage: what it writes, that every variant trains, that an interrupted run resumes bit for bit."""

import json
import os
import signal
import subprocess
import sys
import time

import pytest
import torch
from safetensors.torch import load_file

from racerl.config import compose_settings
from racerl.control.policy import load_policy
from racerl.errors import ConfigError, RunError
from racerl.run import RunFolder
from racerl.train import session
from racerl.train.ascent import Climb
from racerl.train.checkpoint import FILE as CHECKPOINT
from racerl.train.ppo import RacePPO
from racerl.train.refinement import Search
from racerl.train.session import rank
from racerl.train.train import train
from tests.conftest import CONF
from tests.train.pulled import Plug, logged, pull_at
from tests.train.short import ascent, refinement

SMOKE = ["budget=smoke", "threads=1"]


def test_a_finished_run_holds_policy_log_and_manifest(smoke_run):
    folder = RunFolder.open_complete(smoke_run, "train")
    assert folder.manifest["steps"] == 2048 and folder.manifest["seed"] == 0 and folder.manifest["threads"] == 1
    assert folder.manifest["made_of"] == "PPO"
    lines = [json.loads(line) for line in (smoke_run / "progress.jsonl").read_text().splitlines()]
    assert [line["steps"] for line in lines] == [1024, 2048, 2048] and "train/reward" in lines[1]
    assert "evaluation/crash_share" in lines[2] and "train/reward" in lines[2]  # of the last update and examination
    assert any((smoke_run / "tensorboard").iterdir()) and not (smoke_run / CHECKPOINT).exists()
    assert load_policy(smoke_run).sizes == [50, 32, 32, 2]
    assert folder.settings()["dr"]["sigma"] == 0.02
    assert str(smoke_run.parent) not in (smoke_run / "manifest.json").read_text()


@pytest.mark.parametrize(
    "variant",
    [
        "obs=progress",
        pytest.param("obs.points=5", marks=pytest.mark.slow),
        "action=speed",
        "sim=no_actuators",
        "dr=none",
        pytest.param("dr=friction_0.1", marks=pytest.mark.slow),
        "dr=all_0.05",
        pytest.param("dr.sigma=0.07", marks=pytest.mark.slow),
        "+vehicle/effect=[tyre_relaxation,aero_drag]",
        ["action=current", "sim=motor_current"],
    ],
)
def test_every_variant_trains(variant, tmp_path):
    overrides = [variant] if isinstance(variant, str) else variant
    facts = train(
        compose_settings("train", [*SMOKE, "dr=friction_0.02", "budget.steps=1024", *overrides]), tmp_path / "run"
    )
    assert facts["steps"] == 1024 and facts["nan_cars"] == 0
    assert RunFolder.open_complete(tmp_path / "run").manifest["status"] == "complete"


def test_an_interrupted_run_resumes_bit_for_bit(smoke_run, tmp_path, monkeypatch):
    settings = compose_settings("train", [*SMOKE, "dr=friction_0.02"])
    monkeypatch.setattr(session, "CHECKPOINT_PERIOD", 0.0)
    out = tmp_path / "run"
    with pytest.raises(Plug):
        train(settings, out, pull_at(1024))
    with pytest.raises(RunError, match="not complete"):
        RunFolder.open_complete(out)
    train(settings, out)
    undisturbed, resumed = load_file(smoke_run / "policy.safetensors"), load_file(out / "policy.safetensors")
    assert all(torch.equal(undisturbed[name], resumed[name]) for name in undisturbed)
    steps = {json.loads(line)["steps"] for line in (out / "progress.jsonl").read_text().splitlines()}
    assert steps == {1024, 2048}


@pytest.mark.parametrize("kind", [["obs=history", "algo.privileged=true"], ["algo=ppo_recurrent"]])
def test_the_course_of_a_run_pulled_twice_is_that_of_an_undisturbed_one(tmp_path, monkeypatch, kind):
    words = ["budget.steps=6144", "budget.final_std=0.1", "budget.final_learning_rate=1e-5", "budget.normalise=true"]
    words += kind
    settings = compose_settings("train", [*SMOKE, "dr=friction_0.02", *words])
    train(settings, tmp_path / "whole")
    pull = pull_at(1024, 2048, 4096)
    for period in (1e6, 0.0, 0.0):  # before its first checkpoint, and behind others
        monkeypatch.setattr(session, "CHECKPOINT_PERIOD", period)
        with pytest.raises(Plug):
            train(settings, tmp_path / "pulled", pull)
        (tmp_path / "pulled" / "progress.jsonl").open("a").write('{"steps": 3')  # torn, and never read again
    train(settings, tmp_path / "pulled")
    assert logged(tmp_path / "pulled") == logged(tmp_path / "whole")
    one, other = ((tmp_path / run / "policy.safetensors").read_bytes() for run in ("pulled", "whole"))
    assert one == other
    assert not list((tmp_path / "pulled").glob("*checkpoint*"))


def test_a_killed_process_resumes(tmp_path):
    code = (
        "import sys; from pathlib import Path; from racerl.train import session; session.CHECKPOINT_PERIOD = 0.0;"
        "from racerl.train.train import train as t;"
        "from racerl.config import compose_settings as c;"
        "t(c('train', ['budget=smoke', 'threads=1', 'budget.steps=200000']), Path(sys.argv[1]))"
    )
    out = tmp_path / "run"
    job = subprocess.Popen([sys.executable, "-c", code, str(out)])
    deadline = time.monotonic() + 90
    log = out / "progress.jsonl"
    while not (log.exists() and log.read_text().count("\n") >= 4) and time.monotonic() < deadline:
        time.sleep(0.1)
    os.kill(job.pid, signal.SIGKILL)
    job.wait()
    seen = []

    class Enough(Exception):
        pass

    def watch(progress):
        seen.append(progress.steps)
        raise Enough

    with pytest.raises(Enough):
        train(compose_settings("train", ["budget=smoke", "threads=1", "budget.steps=200000"]), out, watch)
    assert seen[0] >= 1024


def test_a_damaged_checkpoint_is_named(tmp_path):
    settings = compose_settings("train", SMOKE)
    out = tmp_path / "run"
    RunFolder.start(out, "train", settings)
    (out / CHECKPOINT).write_bytes(b"\x10" * 64)
    with pytest.raises(RunError, match="damaged"):
        train(settings, out)


def test_a_run_goes_on_from_the_checkpoint_before_a_damaged_one(smoke_run, tmp_path, monkeypatch, caplog):
    settings = compose_settings("train", [*SMOKE, "dr=friction_0.02"])
    monkeypatch.setattr(session, "CHECKPOINT_PERIOD", 0.0)
    out = tmp_path / "run"
    with pytest.raises(Plug):
        train(settings, out, pull_at(1024))
    newest, before = out / CHECKPOINT, out / f"before.{CHECKPOINT}"
    content = bytearray(newest.read_bytes())
    content[len(content) // 2] ^= 1  # one bit
    newest.write_bytes(content)
    assert before.is_file()
    with pytest.raises(Plug):
        train(settings, out, pull_at(1024))
    assert "damaged" in caplog.text
    assert not before.exists() or before.read_bytes() != bytes(content)  # it has not taken the place of a whole one
    train(settings, out)
    assert (out / "policy.safetensors").read_bytes() == (smoke_run / "policy.safetensors").read_bytes()


@pytest.mark.parametrize("rollouts", [1, 3])
def test_a_learner_that_diverges_stops_and_leaves_its_last_good_policy(rollouts, tmp_path, monkeypatch):
    words = [*SMOKE, "budget.steps=6144", "budget.evaluations=6"]
    learn, done = RacePPO.train, []

    def poisoned(model):
        learn(model)
        done.append(True)
        if len(done) == rollouts + 1:
            with torch.no_grad():
                model.policy.value_net.bias.fill_(float("nan"))

    monkeypatch.setattr(RacePPO, "train", poisoned)
    with pytest.raises(RunError, match=rf"diverged after {1024 * (rollouts + 1):,} .*critic.*learning_rate.*kept in"):
        train(compose_settings("train", words), tmp_path / "run")
    assert len(done) == rollouts + 1  # nothing more was learned
    folder = RunFolder.open_complete(tmp_path / "run", "train")
    assert "critic's weights are not finite" in folder.manifest["diverged"]
    assert folder.manifest["best"]["steps"] <= 1024 * rollouts
    policy = load_policy(tmp_path / "run")
    assert all(bool(weight.isfinite().all()) for weight in policy.network.parameters())


@pytest.mark.parametrize(
    ("improver", "word", "number"),
    [
        (Search, refinement(generations=4, evaluations=4), r"refinement\.step"),
        (Climb, ascent(), r"ascent\.learning_rate"),
    ],
)
def test_a_refinement_that_diverges_leaves_the_policy_from_before(improver, word, number, tmp_path, monkeypatch):
    advance = improver.advance

    def poisoned(found):
        measures = advance(found)
        if found.done == 2:
            with torch.no_grad():
                [*found.network.parameters()][-1].fill_(float("inf"))
        return measures

    monkeypatch.setattr(improver, "advance", poisoned)
    with pytest.raises(RunError, match=rf"policy's weights are not finite; lower budget\.{number}"):
        train(compose_settings("train", [*SMOKE, word]), tmp_path / "run")
    policy = load_policy(tmp_path / "run")
    assert all(bool(weight.isfinite().all()) for weight in policy.network.parameters())


def test_a_run_does_not_go_on_in_a_car_whose_file_has_changed(tmp_path):
    model = tmp_path / "model.yaml"
    model.write_text((CONF / "vehicle" / "published.yaml").read_text())
    settings = compose_settings("train", [*SMOKE, f"vehicle={model}"])
    with pytest.raises(Plug):
        train(settings, tmp_path / "run", pull_at(1024))
    model.write_text(model.read_text().replace("mass: ", "mass: 1"))
    with pytest.raises(RunError, match=r"model\.yaml has changed since this training began"):
        train(settings, tmp_path / "run")


def test_results_are_never_overwritten(smoke_run, tmp_path):
    settings = compose_settings("train", [*SMOKE, "dr=friction_0.02"])
    with pytest.raises(RunError, match="already holds this very run"):
        train(settings, smoke_run)
    with pytest.raises(RunError, match="another train run"):
        train({**settings, "seed": 5}, smoke_run)
    (tmp_path / "precious.txt").write_text("mine")
    with pytest.raises(RunError, match="not empty"):
        train(settings, tmp_path)
    with pytest.raises(RunError, match="is a file"):
        train(settings, tmp_path / "precious.txt")


@pytest.mark.parametrize(
    "change, said",
    [
        ({"seed": -1}, "seed"),
        ({"budget": {**compose_settings("train", SMOKE)["budget"], "batch": 1}}, "budget.batch = 1"),
        ({"seed": "x"}, "seed"),
        ({"threads": 0}, "threads"),
        ({"device": "tpu"}, "device"),
        ({"sim": {}}, "sim.dt"),
        ({"obs": None}, "obs"),
        ({"algo": None}, "algo"),
        ({"algo": {"name": "imitations"}}, "did you mean imitation"),
        ({"dr": {"sigma": 0.1, "parameters": [3]}}, "parameters"),
    ],
)
def test_wrong_settings_write_nothing(change, said, tmp_path):
    with pytest.raises(ConfigError, match=said):
        train({**compose_settings("train", SMOKE), **change}, tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_the_best_policy_is_kept():
    clean = {"crash_share": 0.0, "laps": 32, "valid_laps": 32, "e_off": 0.0, "settled_lap_s": 6.0}
    assert rank(clean) < rank({**clean, "settled_lap_s": 6.1})
    assert rank(clean) < rank({**clean, "crash_share": 0.1, "settled_lap_s": 5.0})
    assert rank(clean) < rank({**clean, "settled_lap_s": None})
    crashed_once = {**clean, "crash_share": 0.03}
    assert rank(crashed_once) < rank({**clean, "laps": 0, "valid_laps": 0, "settled_lap_s": None})  # it only crept


def test_the_best_policy_may_leave_the_track_by_a_hair():
    clean = {"crash_share": 0.0, "laps": 32, "valid_laps": 32, "e_off": 0.0, "settled_lap_s": 6.0}
    assert rank(clean) < rank({**clean, "valid_laps": 22, "e_off": 0.0004, "settled_lap_s": 5.0})
    assert rank({**clean, "valid_laps": 30, "e_off": 0.0004, "settled_lap_s": 5.9}) < rank(clean)
    assert rank(clean) < rank({**clean, "e_off": 0.002, "settled_lap_s": 5.0})
    assert rank({**clean, "settled_lap_s": None}) < rank({**clean, "crash_share": 0.1, "settled_lap_s": 5.0})


@pytest.mark.gpu
@pytest.mark.parametrize(("ending", "more"), [([], 0), ([refinement()], 2 * 16 * 45), ([ascent()], 4 * 16 * 25)])
def test_trains_on_a_gpu(ending, more, tmp_path):
    facts = train(compose_settings("train", [*SMOKE, "device=cuda", *ending]), tmp_path / "run")
    assert facts["steps"] == 2048 + more
    assert RunFolder.open_complete(tmp_path / "run").manifest["device"].startswith("cuda")


@pytest.mark.slow
def test_a_laptop_policy_laps_cleanly(tmp_path):
    """A minute: a quarter of the laptop budget, its schedules shortened alike, must lap without a crash."""
    settings = compose_settings(
        "train", ["dr=friction_0.02", "budget.steps=3000000", "budget.evaluations=3", "budget=unrefined"]
    )
    facts = train(settings, tmp_path / "run")
    assert facts["best"]["crash_share"] == 0.0 and facts["best"]["mean_lap_s"] < 8.0
