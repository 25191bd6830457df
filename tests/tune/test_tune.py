"""Tuning: it starts from what is there, never ends worse, and says what cannot be looked for."""

import json

import pytest

from racerl.config import compose_settings
from racerl.documents import read_yaml
from racerl.errors import ConfigError
from racerl.evaluate.laps import Lap
from racerl.tune.tune import CRASH, NEVER, per_valid_lap, tune


def settings(*words, line):
    base = ["controller=pure_pursuit", f"controller.raceline={line}", "trials=4", "laps=1", "seeds=[0]", "dr=none"]
    return compose_settings("tune", [*base, "search={speed: [0.3, 0.75]}", *words])


@pytest.fixture(scope="module")
def line(tmp_path_factory):
    """A raceline along the middle of the track, at 2 m/s."""
    from racerl.assemble import build_track

    track = build_track(compose_settings("train"))
    path = tmp_path_factory.mktemp("line") / "line.csv"
    path.write_text("\n".join(f"0; {x}; {y}; 0; 0; 2.0; 0" for x, y in zip(track.x, track.y, strict=True)))
    return path


def lap(time=5.0, off=0.0, crashed=False):
    return Lap(0, 1, None if crashed else time, off, off, crashed)


def test_what_counts_is_the_time_driven_for_every_valid_lap():
    assert per_valid_lap([lap(5.0), lap(7.0)]) == 6.0
    assert per_valid_lap([lap(5.0), lap(5.0, off=0.01)]) == 10.0
    assert per_valid_lap([lap(5.0), lap(crashed=True)]) == 5.0 + CRASH
    assert per_valid_lap([lap(5.0, off=0.01)]) == NEVER


@pytest.mark.slow
def test_a_faster_controller_is_found_and_kept(tmp_path, line):
    facts = tune(settings("controller.speed=0.35", line=line), tmp_path / "a")
    trials = [row["seconds_per_valid_lap"] for row in facts["trials"]]
    assert facts["trials"][0]["speed"] == 0.35 and len(trials) == 4
    assert facts["best"]["seconds_per_valid_lap"] == min(trials) < trials[0]
    written = read_yaml(tmp_path / "a" / "controller.yaml")
    assert written["name"] == "pure_pursuit" and written["speed"] == facts["best"]["speed"]
    assert json.loads((tmp_path / "a" / "tune.json").read_text()) == facts
    # the same again
    assert tune(settings("controller.speed=0.35", line=line), tmp_path / "b") == facts


@pytest.mark.parametrize(
    "search, said",
    [
        ({"spede": [0.3, 0.6]}, "did you mean speed"),
        ({"raceline": [0.3, 0.6]}, "no such number"),
        ({"speed": [0.6]}, "two numbers"),
        ({"speed": [0.8, 0.9]}, "around 0.7"),
        ({"speed": [0.0, 0.9]}, "search.speed = 0.0"),
        ({}, "mapping"),
    ],
)
def test_what_cannot_be_looked_for_is_told(search, said, tmp_path, line):
    with pytest.raises(ConfigError, match=said):
        tune({**settings(line=line), "search": search}, tmp_path / "no")
    assert not (tmp_path / "no").exists()


def test_without_optuna_it_says_what_to_install(tmp_path, line, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "optuna", None)
    with pytest.raises(Exception, match="pip install"):
        tune(settings(line=line), tmp_path / "no")
