"""A recorded drive is scored as the race was that it was recorded in."""

import numpy as np
import pandas as pd
import pytest

from racerl.config import compose_settings
from racerl.env.termination import Crash
from racerl.errors import RacerlError
from racerl.evaluate.drive import Recorder, drive
from racerl.evaluate.evaluate import evaluate
from racerl.report.report import report
from tests.env.test_race import make
from tests.evaluate.test_evaluate import Follower


@pytest.fixture(scope="module")
def raced(tmp_path_factory):
    """Laps of a slow driver in three cars, and the log of them."""
    race = make("sim.max_steps=1000000", cars=3, seeds=[0, 1, 2], termination=Crash())
    recorder = Recorder(race, [0, 1, 2])
    laps = drive(race, Follower(), 3, recorder)
    path = tmp_path_factory.mktemp("log") / "drive.parquet"
    recorder.log().to_parquet(path)
    return laps, path


def scored(path, out, *words):
    return evaluate(compose_settings("evaluate", [f"run='{path}'", "track=l_shape", *words]), out)


def test_the_log_of_a_race_has_the_laps_of_the_race(raced, tmp_path):
    laps, path = raced
    metrics = scored(path, tmp_path / "out")
    driven = {(lap.car, lap.number): lap for lap in laps}
    assert metrics["crash_share"] == 0.0 and len(metrics["rows"]) >= 6  # the drive ends inside some third laps
    for row in metrics["rows"]:
        lap = driven[row["car"], row["number"]]
        assert row["time_s"] == pytest.approx(lap.time_s, abs=2e-3)
        assert row["e_off"] == pytest.approx(lap.e_off, abs=1e-5) and row["valid"] == lap.valid


def test_leaving_the_track_and_turning_around_show(raced, tmp_path):
    _, path = raced
    log = pd.read_parquet(path)
    log = log[log["run"] == log["run"].iloc[0]].reset_index(drop=True)
    middle = len(log) // 2
    there = log.index[middle - 4 : middle + 4]
    log.loc[there, "yaw"] += np.pi  # once around, and back
    log.to_parquet(tmp_path / "spun.parquet")
    metrics = scored(tmp_path / "spun.parquet", tmp_path / "spun")
    assert sum(row["crashed"] for row in metrics["rows"]) == 1
    pushed = log.assign(yaw=pd.read_parquet(path)["yaw"].iloc[: len(log)].to_numpy())
    pushed.loc[there, "x"] += 0.1  # no more than beside the line
    pushed.loc[there, "y"] += 0.55 * np.sign(pushed["n"].iloc[middle] or 1.0)
    pushed.to_parquet(tmp_path / "pushed.parquet")
    metrics = scored(tmp_path / "pushed.parquet", tmp_path / "pushed")
    assert metrics["max_off_track_m"] > 0.0 and metrics["e_off"] > 0.0


def test_a_log_stands_in_the_report_beside_policies(raced, smoke_evaluation, tmp_path):
    _, path = raced
    log = pd.read_parquet(path).drop(columns=["delta", "delta_ref", "v_y", "yaw_rate"])
    log.to_csv(tmp_path / "poses.csv.gz", index=False)
    out = tmp_path / "outputs" / "evaluate" / "log"
    scored(tmp_path / "poses.csv.gz", out)
    words = compose_settings("report", [f"runs=['{out}','{smoke_evaluation}']"])
    page = report(words, tmp_path / "page", tmp_path / "outputs").read_text()
    assert "log poses.csv.gz" in page and "recorded" in page


def test_a_drive_beside_its_track_is_told(raced, tmp_path, caplog):
    scored(raced[1], tmp_path / "there")
    assert not caplog.records
    log = pd.read_parquet(raced[1])
    log.assign(x=log["x"] + 20.0).to_parquet(tmp_path / "away.parquet")
    scored(tmp_path / "away.parquet", tmp_path / "away")
    assert "is off the track l_shape in 100 % of its samples" in caplog.text


def test_velocities_come_from_the_poses_where_they_are_missing(raced, tmp_path):
    pd.read_parquet(raced[1]).drop(columns=["v_x", "v_y", "yaw_rate"]).to_parquet(tmp_path / "poses.parquet")
    metrics = scored(tmp_path / "poses.parquet", tmp_path / "out")
    assert metrics["valid_laps"] > 0 and metrics["crash_share"] == 0.0


def test_what_cannot_be_scored_is_told(raced, tmp_path):
    pd.read_parquet(raced[1]).drop(columns=["x"]).to_parquet(tmp_path / "less.parquet")
    with pytest.raises(RacerlError, match="has no x; laps need poses"):
        scored(tmp_path / "less.parquet", tmp_path / "out")
    with pytest.raises(RacerlError, match="say on which track"):
        evaluate(compose_settings("evaluate", [f"run='{raced[1]}'"]), tmp_path / "out")
    with pytest.raises(RacerlError, match="a choice of conf/track is expected"):
        scored(raced[1], tmp_path / "out", "track=null")
    assert not (tmp_path / "out").exists()
