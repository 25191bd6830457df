"""A run handed over may hold anything in its configuration: one line each, nothing hangs."""

import copy
import time

import pytest
import yaml

from racerl.assemble import build_race
from racerl.config import compose_settings
from racerl.control.networks import build_network
from racerl.control.policy import save_policy
from racerl.documents import conf_folder
from racerl.errors import RacerlError
from racerl.evaluate import evaluate as stage
from racerl.run import RunFolder
from racerl.train.session import policy_of
from racerl.train.train import train
from racerl.vehicle import kernel

NASTY = [None, 3, 0, -1, 1e30, True, "x", "", "a\0b", "x" * 5000, "/dev/zero", [], [1, 2], ["a"], {}, {"a": 1}]
NOT_READ = ("budget", "algo", "seed", "threads", "device", "out")  # by whoever races the policy


class Reached(Exception):
    """The race would begin."""


@pytest.fixture(scope="module")
def handed_over(tmp_path_factory):
    """Return a finished run with a random policy, its configuration, and the settings that race it."""
    out = tmp_path_factory.mktemp("handed_over") / "run"
    settings = compose_settings("train", ["+dr=friction_0.02"])
    race = build_race(settings, cars=1, seeds=[0])
    folder = RunFolder.start(out, "train", settings, seed=0)
    save_policy(policy_of(build_network([race.observation.size, 4, 2]), race, settings), out)
    folder.finish(steps=0, seconds=0.0)
    return out, settings, compose_settings("evaluate", [f"run={out}"])


@pytest.fixture
def race_with(handed_over, tmp_path, monkeypatch):
    """Return what races the run with one key of its configuration changed, up to the first step."""
    run, stored, settings = handed_over
    monkeypatch.setattr(kernel, "build", lambda code: None)

    def reached(*_):
        raise Reached

    monkeypatch.setattr(stage, "drive_against_floor", reached)

    def race(path, value, number=0):
        changed = copy.deepcopy(stored)
        inner = changed
        for key in path[:-1]:
            inner = inner[key]
        inner[path[-1]] = value
        (run / "config.yaml").write_text(yaml.safe_dump(changed, sort_keys=False))
        stage.evaluate(settings, tmp_path / str(number))

    return race


@pytest.mark.parametrize(
    "path, value",
    [
        (("vehicle", "effects"), "x"),
        (("vehicle", "effects"), {"aero_drag": 3}),
        (("vehicle", "file"), 3),
        (("vehicle", "file"), "a\0b"),
        (("vehicle",), {"file": "/dev/zero"}),
        (("track", "file"), "x" * 5000),
        (("track", "file"), "a\0b"),
        (("dr", "parameters"), {"a": 1}),
        (("obs", "name"), ["a"]),
        (("action",), "speed"),
    ],
)
def test_what_no_training_writes_is_one_line(path, value, race_with):
    with pytest.raises(RacerlError) as told:
        race_with(path, value)
    assert "\n" not in str(told.value)


def test_a_sound_configuration_is_raced(race_with):
    with pytest.raises(Reached):
        race_with(("dr", "sigma"), 0.02)


@pytest.mark.soak
def test_every_key_with_anything_in_it_is_one_line_or_a_race(handed_over, race_with):
    cases = [(path, value) for path in _paths(handed_over[1]) if path[0] not in NOT_READ for value in NASTY]
    assert len(cases) > 1000
    for number, (path, value) in enumerate(cases):
        began = time.perf_counter()
        with pytest.raises((RacerlError, Reached)):
            race_with(path, value, number)
        assert time.perf_counter() - began < 2.0, (path, value)


def _paths(settings, above=()):
    for key, value in settings.items():
        yield (*above, key)
        if isinstance(value, dict):
            yield from _paths(value, (*above, key))


def test_a_vehicle_that_has_changed_since_the_training_is_told(tmp_path, caplog):
    car = tmp_path / "car.yaml"
    car.write_text((conf_folder() / "vehicle" / "published.yaml").read_text())
    settings = compose_settings("train", ["budget=smoke", "budget.steps=1024", f"vehicle={car}"])
    train(settings, tmp_path / "run")
    race(tmp_path / "run", tmp_path / "one")
    assert "has changed" not in caplog.text
    car.write_text(car.read_text() + "# another\n")
    race(tmp_path / "run", tmp_path / "elsewhere", "vehicle=f1tenth")
    assert "has changed" not in caplog.text  # it is not read
    race(tmp_path / "run", tmp_path / "other")
    assert f"{car} has changed since {tmp_path / 'run'} was trained" in caplog.text


def race(run, out, *words):
    settings = compose_settings("evaluate", ["run=policy", "laps=1", "seeds=[0]", *words])
    stage.evaluate({**settings, "run": str(run)}, out)
