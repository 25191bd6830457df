"""Rivals as rows: what their races leave, the bound under them, and the paper's laps by our clock."""

import json

import pandas as pd
import pytest

from racerl.assemble import build_track
from racerl.config import compose_settings
from racerl.errors import ConfigError, OptimumError
from racerl.evaluate.against import FINDING
from racerl.evaluate.evaluate import evaluate
from racerl.evaluate.rivals import race
from racerl.optimum import kept
from racerl.optimum.collocation import Collocation
from racerl.optimum.corridor import Corridor
from racerl.optimum.optimum import Optimum
from racerl.report.subjects import find_subjects


def raced(out, *words):
    metrics = race(compose_settings("race", words), out)
    assert json.loads((out / "metrics.json").read_text()) == metrics
    return metrics


@pytest.mark.slow
def test_a_race_leaves_what_a_policys_leaves(tmp_path, middle_line, monkeypatch):
    monkeypatch.setattr(kept, "find_optimum", no_lap)  # another test's
    words = ["controller=pure_pursuit", f"controller.raceline={middle_line}", "laps=1", "seeds=[0,1]", "car=twin"]
    metrics = raced(tmp_path / "a", *words)
    assert metrics["laps"] == 2 and metrics["car"] == "twin" and metrics["label"] == "pure pursuit"
    drive = pd.read_parquet(tmp_path / "a" / "trajectories.parquet")
    assert set(drive["seed"]) == {0, 1} and drive["lap"].max() >= 1
    # the same again
    assert raced(tmp_path / "b", *words)["rows"] == metrics["rows"]
    (subject,) = find_subjects([tmp_path / "a"], tmp_path)
    assert subject.title == "pure pursuit" and subject.evaluation is not None


def no_lap(*asked):
    raise OptimumError("no lap")


@pytest.fixture
def line(tmp_path):
    """A raceline, so that nothing has to be found for it: the centreline, slowly."""
    track = build_track(compose_settings("race"))
    path = tmp_path / "line.csv"
    path.write_text("\n".join(f"0; {x}; {y}; 0; 0; 1.5; 0" for x, y in zip(track.x, track.y, strict=True)))
    return path


@pytest.mark.slow
def test_laps_are_set_against_the_optimum_that_nobody_asked_for(line, tmp_path, monkeypatch):
    """It is found once, told while it is, and kept; laps without it are laps all the same."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    found = []

    def find(vehicle, track, action, on_share):
        found.append(vehicle)
        on_share(0.5)
        if float(vehicle.friction) < 0.8:
            raise OptimumError("no lap")
        corridor = Corridor(track)
        problem = Collocation(vehicle, action, corridor, 60)
        return Optimum(problem.solve(problem.guess(0.0)), corridor, [], [])

    monkeypatch.setattr(kept, "find_optimum", find)
    told = []

    def driven(name, *words):
        settings = compose_settings("race", ["controller=pure_pursuit", f"controller.raceline={line}", *words])
        return race({**settings, "laps": 1, "seeds": [0]}, tmp_path / name, lambda *each: told.append(each))

    first, again = driven("a"), driven("b")
    assert len(found) == 1 and 5.0 < first["optimum_s"] < 6.0 and again["optimum_s"] == first["optimum_s"]
    assert first["mean_over_optimum"] == pytest.approx(first["mean_lap_s"] / first["optimum_s"] - 1.0)
    assert (0.75, FINDING) in told and told.count((1.0, "lap 1 of 1")) == 1
    assert driven("c", "vehicle.friction=0.7")["mean_over_optimum"] is None and len(found) == 2


def test_a_policy_without_a_lap_has_nothing_to_be_set_against(smoke_run, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(kept, "find_optimum", lambda *given: pytest.fail("nobody asked for it"))
    metrics = evaluate(compose_settings("evaluate", [f"run='{smoke_run}'", "laps=1", "seeds=[0]"]), tmp_path / "race")
    assert metrics["mean_lap_s"] is None and metrics["optimum_s"] is None


@pytest.mark.slow
def test_the_optimum_is_a_lap_that_nobody_drives(tmp_path):
    bound = raced(tmp_path / "bound", "controller=optimum")
    assert bound["laps"] == bound["valid_laps"] == 1 and bound["e_off"] == 0.0
    assert bound["mean_lap_s"] == pytest.approx(5.154, abs=0.003)


@pytest.mark.slow
def test_the_twins_optimum_is_slower(tmp_path):
    bound = raced(tmp_path / "bound", "controller=optimum")
    slower = raced(tmp_path / "twin", "controller=optimum", "car=twin")
    assert bound["mean_lap_s"] < slower["mean_lap_s"] < 5.35  # less grip, but the same limits


def test_the_papers_human_is_scored_by_our_clock(tmp_path):
    settings = compose_settings("evaluate", ["run=paper:human", "track=l_shape"])
    metrics = evaluate(settings, tmp_path / "human")
    assert metrics["laps"] == 1 and metrics["mean_lap_s"] == pytest.approx(5.847, abs=0.01)
    assert metrics["label"] == "the paper's human, Fig. 6"
    with pytest.raises(ConfigError, match="paper:human"):
        evaluate(compose_settings("evaluate", ["run=paper:humen", "track=l_shape"]), tmp_path / "no")
    with pytest.raises(ConfigError, match="track=l_shape"):
        evaluate(compose_settings("evaluate", ["run=paper:human"]), tmp_path / "no")
    assert not (tmp_path / "no").exists()


@pytest.mark.parametrize(
    "words, said",
    [
        (["controller=mpd"], "mpc"),
        (["controller=mpc", "laps=0"], "laps = 0"),
        (["controller=mpc", "seeds=[]"], "seeds"),
        (["controller=mpc", "controller.speed=1"], "controller.speed"),
    ],
)
def test_mistakes_are_one_line_and_leave_nothing(words, said, tmp_path):
    with pytest.raises(ConfigError, match=said) as error:
        race(compose_settings("race", words), tmp_path / "no")
    assert "\n" not in str(error.value) and not (tmp_path / "no").exists()
