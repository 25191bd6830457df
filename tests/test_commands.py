"""racerl from Python: from a simulated drive to a diagnosis, a policy and its laps."""

import shutil

import numpy as np
import pytest
import torch

from racerl.commands import (
    Diagnosis,
    Laps,
    Optimum,
    Recording,
    Training,
    _written,
    evaluate,
    gap,
    identify,
    optimum,
    race,
    record,
    train,
)
from racerl.errors import ConfigError, RunError
from racerl.gap.hypotheses import Hypothesis
from racerl.vehicle import catalogue
from tests.train.short import refinement

DAMPED = ("+vehicle/effect=yaw_damping", "vehicle.effects.yaw_damping.coefficient=0.15")


@pytest.fixture(scope="module")
def told():
    return []


@pytest.fixture(scope="module")
def recorded(tmp_path_factory, told):
    out = tmp_path_factory.mktemp("library") / "drive"
    return record(*DAMPED, vehicle="published", seconds=60, out=out, on_progress=lambda *now: told.append(now))


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    return train("+dr=friction_0.02", budget="smoke", threads=1, out=tmp_path_factory.mktemp("library") / "policy")


def test_a_drive_is_recorded_and_read_again(recorded, told):
    assert recorded.log.is_file() and recorded.facts["rows"] == 6000
    assert Recording.of(recorded.folder).log == recorded.log
    shares = [share for share, _ in told]
    assert shares == sorted(shares) and shares[0] == 0.0 < shares[-1] < 1.0


def test_a_car_is_identified_with_intervals(recorded, tmp_path):
    hold = ["front.*", "rear.*", "drive.*"]
    car = tmp_path / "car"
    found = identify(recorded.log, vehicle="published", hold=hold, starts=1, folds=0, threads=1, out=car)
    inertia = found.parameters["yaw_inertia"]
    assert inertia.low < inertia.value < inertia.high and inertia.unit == "kg m²"
    assert found.usable is found.facts["verdict"]["usable"] and found.model.is_file() and found.page.is_file()


@pytest.mark.slow
def test_what_a_car_does_and_its_model_does_not_is_named(recorded, tmp_path):
    others = [name for name in catalogue.names() if name not in ("yaw_damping", "steering_gain")]
    found = gap([recorded.log], vehicle="published", without=others, threads=1, out=tmp_path / "gap")
    assert found.verdict == "named" and found.rivals == () and "yaw_damping" in found.reason
    damping = found.effects["yaw_damping"]["coefficient"]
    assert damping.low < 0.15 < damping.high and damping.unit == "N m s"
    assert found.hypotheses[0] == Hypothesis(("yaw_damping",), found.hypotheses[0].probability)
    assert found.numbers == {} and found.model.is_file() and found.page.is_file()
    assert Diagnosis.of(found.folder).effects == found.effects
    with pytest.raises(RunError, match="gap run"):
        Training.of(found.folder)


def test_wrong_numbers_are_read(tmp_path):
    change = {"parameter": "friction", "from": 0.8, "to": 0.5, "ci95": [0.49, 0.51]}
    found = Diagnosis(tmp_path, {"configured": {"changes": [change]}})
    assert found.numbers["friction"] == (0.8, 0.5, 0.49, 0.51)


def test_a_policy_is_trained_and_raced(trained, tmp_path):
    seen = torch.zeros(3, trained.policy.sizes[0])
    assert trained.policy(seen).shape == (3, 2)
    laps = evaluate(trained.folder, car="twin", laps=1, seeds=[0, 1], threads=1, out=tmp_path / "laps")
    assert laps.facts["car"] == "twin" and len(laps.laps) == 2 and laps.facts["seed"] == [0, 1]
    assert (laps.mean_lap, laps.optimum) == (laps.facts["mean_lap_s"], laps.facts["optimum_s"])
    assert {"t", "x", "y"} <= set(laps.trajectories.columns)
    assert Laps.of(laps.folder).facts == laps.facts


def test_a_policy_is_refined_onward(trained, tmp_path):
    words = f"from={trained.folder}", refinement(), "vehicle=published"
    onward = train(*words, budget="smoke", threads=1, out=tmp_path / "on")
    assert onward.facts["stage"] == "train" and (onward.folder / "unrefined").is_dir()


def test_a_rival_is_raced(tmp_path):
    laps = race(controller="pure_pursuit", laps=2, seeds=[0], threads=1, out=tmp_path / "rival")
    assert laps.facts["controller"] == "pure pursuit" and 6.0 < laps.settled_lap < 9.0


@pytest.mark.slow
def test_no_lap_is_faster_than_the_bound(tmp_path):
    bound = optimum(vehicle="published", threads=1, out=tmp_path / "optimum")
    laps = race(controller="pure_pursuit", laps=3, seeds=[0], out=tmp_path / "rival")
    assert Optimum.of(bound.folder).lap == bound.lap < laps.settled_lap


def test_what_is_mistyped_is_said_in_one_line(recorded, tmp_path):
    with pytest.raises(ConfigError, match="unknown key 'secnods'; did you mean seconds"):
        record(secnods=3, out=tmp_path / "a")
    with pytest.raises(ConfigError, match="no such file or folder"):
        identify(tmp_path / "nowhere.parquet")
    assert not (tmp_path / "a").exists()


PLAIN = ("mu=0.8, grippy.parquet", "fährt 1.parquet", "[a]'b.parquet")


@pytest.mark.parametrize(
    "name", ["mu=0.8, fährt [a]'b.parquet", *(pytest.param(name, marks=pytest.mark.slow) for name in PLAIN)]
)
def test_any_path_is_taken_as_it_is(recorded, tmp_path, name):
    copy = shutil.copy(recorded.log, tmp_path / name)
    out = tmp_path / f"of {name}"
    seen = identify(copy, vehicle="published", fit=False, threads=np.int64(1), out=out)
    assert seen.folder == out and seen.parameters == {} and seen.page.is_file()
    assert seen.facts["logs"][0]["name"] == name
    with pytest.raises(RunError, match="nothing was fitted"):
        _ = seen.model


def test_a_folder_of_its_own_for_every_call(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    drives = [record(seconds=5, drive="race", file="fährt, 1.parquet", seed=seed) for seed in np.arange(2)]
    assert drives[0].folder != drives[1].folder and all(drive.log.is_file() for drive in drives)


def test_values_are_written_as_on_the_command_line(tmp_path):
    wanted = {"true": True, "null": None, "0.5": np.float32(0.5), "3": np.int64(3), "[1,'a,b',null]": [1, "a,b", None]}
    assert {_written("x", value): value for value in wanted.values()} == wanted
    assert _written("x", tmp_path) == f"'{tmp_path}'" and float(_written("x", 1e-7)) == 1e-7
    with pytest.raises(ConfigError, match=r"x = {'a': 1}: a number, a text"):
        _written("x", {"a": 1})
