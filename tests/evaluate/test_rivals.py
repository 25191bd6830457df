"""Rivals as rows: what their races leave, the bound under them, and the paper's laps by our clock."""

import json

import pandas as pd
import pytest

from racerl.config import compose_settings
from racerl.errors import ConfigError
from racerl.evaluate.evaluate import evaluate
from racerl.evaluate.rivals import race
from racerl.report.subjects import find_subjects


def raced(out, *words):
    metrics = race(compose_settings("race", words), out)
    assert json.loads((out / "metrics.json").read_text()) == metrics
    return metrics


def test_a_race_leaves_what_a_policys_leaves(tmp_path, middle_line):
    words = ["controller=pure_pursuit", f"controller.raceline={middle_line}", "laps=1", "seeds=[0,1]", "car=twin"]
    metrics = raced(tmp_path / "a", *words)
    assert metrics["laps"] == 2 and metrics["car"] == "twin" and metrics["label"] == "pure pursuit"
    drive = pd.read_parquet(tmp_path / "a" / "trajectories.parquet")
    assert set(drive["seed"]) == {0, 1} and drive["lap"].max() >= 1
    # the same again
    assert raced(tmp_path / "b", *words)["rows"] == metrics["rows"]
    (subject,) = find_subjects([tmp_path / "a"], tmp_path)
    assert subject.title == "pure pursuit" and subject.evaluation is not None


def test_the_optimum_is_a_lap_that_nobody_drives(tmp_path):
    bound = raced(tmp_path / "bound", "controller=optimum")
    assert bound["laps"] == bound["valid_laps"] == 1 and bound["e_off"] == 0.0
    assert bound["mean_lap_s"] == pytest.approx(5.164, abs=0.002)


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
