"""Two drivers side by side: delta time, marks, the page, and what cannot be compared."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from racerl.config import run_command
from racerl.data.log import Log
from racerl.documents import conf_folder
from racerl.errors import RacerlError
from racerl.evaluate.outcome import track_table, write_outcome
from racerl.evaluate.recorded import follow
from racerl.paper import human_lap, rl_lap
from racerl.report.compare import compare
from racerl.report.driver import Driver
from racerl.report.figures import attitude
from racerl.report.flying_lap import FlyingLap, delta_time, time_of_line
from racerl.run import RunFolder
from racerl.track.load import read_track

TRACK = read_track(conf_folder() / "track" / "l_shape.csv")
TRACK_TABLE = track_table(TRACK)


@pytest.fixture(scope="module")
def human() -> FlyingLap:
    return Driver.find("paper:human", Path("outputs")).lap


@pytest.fixture
def slower(human):
    """The same lap, driven 10 % slower."""
    return replace(human, time_s=1.1 * human.time_s, samples=human.samples.assign(t=1.1 * human.samples["t"]))


def test_samples_at_one_place_do_not_wipe_a_laps_times_out():
    places, times = np.array([0.02, 0.02, 0.07, 0.12]), np.array([10.0, 10.1, 10.2, 10.3])
    assert time_of_line(places, times) == pytest.approx(10.0 - 0.02 * 0.2 / 0.05)


def raced(path, drive, track=TRACK, stage="evaluate", most=None, **facts):
    """Leave a run folder of a drive that was scored on a track, with at most so many laps."""
    folder = RunFolder.start(path, stage, {"run": path.name})
    laps, table = follow(TRACK, [Log.from_table(path.name, drive)])
    write_outcome(folder, laps[:most], [0], table, track, label=path.name, car="twin", controller="recorded")
    folder.finish(**facts)
    return str(path)


def titled(page):
    """Return a page's title, after checking that its heading is the same."""
    title = re.search("<title>(.*)</title>", page)[1]
    assert title == re.search("<h1>(.*)</h1>", page)[1]
    return title


def test_a_lap_loses_nothing_to_itself(human):
    s = np.linspace(0.0, human.length, 200)
    assert not delta_time(human, human, s).any()


def test_a_slower_lap_falls_behind_all_the_way_by_its_share(human, slower):
    s = np.linspace(0.0, human.length, 200)
    behind = delta_time(slower, human, s)
    assert behind[0] == pytest.approx(0.0, abs=1e-9) and (np.diff(behind) >= -1e-12).all()
    assert behind[-1] == pytest.approx(0.1 * human.time_s)
    np.testing.assert_allclose(behind, -delta_time(human, slower, s))
    np.testing.assert_allclose(behind, 0.1 * human.time_at(s), atol=1e-9)


def test_marks_stand_on_the_line_at_equal_times(human, slower):
    times = 0.5 * np.arange(1, 30)
    marks = human.marks(times)
    assert len(marks) == int(human.time_s / 0.5) and len(slower.marks(times)) == int(1.1 * human.time_s / 0.5)
    np.testing.assert_allclose(slower.marks(1.1 * times)[:-1], marks[: len(slower.marks(1.1 * times)) - 1], atol=1e-9)
    line, t = human.samples[["x", "y"]].to_numpy(), human.samples["t"].to_numpy()
    for time, mark in zip(times, marks, strict=False):
        after = int(np.searchsorted(t, time))
        step, way = line[after] - line[after - 1], mark - line[after - 1]
        assert abs(step[0] * way[1] - step[1] * way[0]) < 1e-9 and 0.0 <= step @ way <= step @ step


def test_a_slide_is_told_and_drawn_where_the_heading_was_recorded(human):
    plain = attitude.draw([human, human], TRACK_TABLE)
    assert "side slip" not in plain
    samples = human.samples
    course = np.arctan2(np.gradient(samples["y"], samples["t"]), np.gradient(samples["x"], samples["t"]))
    sliding = samples.assign(v_y=-np.tan(np.radians(30.0)) * samples["v_x"], yaw=course + np.radians(30.0))
    shown = attitude.draw([replace(human, samples=sliding), human], TRACK_TABLE)
    assert shown.count("side slip up to 30°") == 1
    assert shown.count("<use ") > plain.count("<use ") + human.time_s / attitude.EVERY - 2  # a nose for each
    sliding.loc[sliding.index[20], ["v_x", "v_y"]] = [-1e-3, 1e-3]  # a car that stands slides to no side
    assert "side slip up to 30°" in attitude.draw([replace(human, samples=sliding), human], TRACK_TABLE)


def test_time_starts_at_the_line_and_ends_with_the_lap(human):
    assert human.time_at(np.array([0.0, human.length])) == pytest.approx([0.0, human.time_s])
    assert human.samples["s"].iloc[0] < 0.0 < human.samples["s"].iloc[1] and human.length == pytest.approx(TRACK.length)


@pytest.mark.parametrize("kept", [(0, 1), (1, 1), (1, 2)])
def test_a_lap_without_the_samples_around_it_keeps_its_time(tmp_path, human, kept):
    run = raced(tmp_path / "cut", human_lap())  # a race stops in the step that crosses the line
    table = tmp_path / "cut" / "trajectories.parquet"
    drive = pd.read_parquet(table)
    drive[drive["lap"].between(*kept)].to_parquet(table)
    lap, s = Driver.find(run, tmp_path).lap, np.linspace(0.0, human.length, 200)
    np.testing.assert_allclose(lap.time_at(s), human.time_at(s), atol=2e-4)


def test_the_page_holds_both_drivers_and_the_papers(tmp_path):
    runs = [raced(tmp_path / name, lap()) for name, lap in (("fast", rl_lap), ("slow", human_lap))]
    pages = [compare({"drivers": runs}, tmp_path / out, tmp_path) for out in ("c1", "c2")]
    page = pages[0].read_text()
    assert page == pages[1].read_text()  # drawn twice, byte by byte
    assert not re.search(r'(src|href)="(?!data:|#)', page) and page.count("</figure>") == 2
    assert titled(page) == "A is 0.291 s faster than B: 5.559 s to 5.850 s"
    for value in ("A: fast", "B: slow", "5.559", "5.850", "paper: MPC", "5.847"):
        assert value in page, value
    assert all((tmp_path / "c1" / name).read_text().startswith("<?xml") for name in ("compare.svg", "attitude.svg"))


def test_the_papers_curves_are_left_out_where_they_do_not_belong(tmp_path):
    other = replace(TRACK, x=TRACK.x + 1.0)
    pair = [raced(tmp_path / name, human_lap(), other) for name in ("a", "b")]
    page = compare({"drivers": pair}, tmp_path / "other", tmp_path).read_text()
    assert "digitised" not in page
    page = compare({"drivers": ["paper:rl", "paper:human"]}, tmp_path / "theirs", tmp_path).read_text()
    assert "digitised" in page and "1 of 1" in page


def test_a_training_run_stands_for_its_newest_evaluation(tmp_path):
    training = RunFolder.start(tmp_path / "train" / "policy", "train", {})
    (training.path / "progress.jsonl").write_text('{"steps": 1}\n')
    training.finish()
    with pytest.raises(RacerlError, match="has not been raced; race it with: racerl evaluate"):
        Driver.find(str(training.path), tmp_path)
    raced(tmp_path / "evaluate" / "policy", human_lap(), train_run_id=training.manifest["run_id"])
    assert Driver.find(str(training.path), tmp_path).lap.time_s == pytest.approx(5.850, abs=1e-3)


@pytest.mark.parametrize(
    "words, said",
    [
        ([], "0 given, two are compared"),
        (["paper:rl"], "1 given, two are compared"),
        (["paper:rl"] * 3, "3 given, two are compared"),
        (["paper:rl", "paper:humn"], "unknown driver 'paper:humn'; did you mean paper:human"),
        (["paper:rl", "nowhere"], "allowed are finished evaluate, drive or train runs, paper:rl"),
        (["paper:rl", "empty"], "is no racerl run folder"),
        (["paper:rl", "report"], "is no run that holds laps"),
        (["paper:rl", "crashed"], "crashed: finished no lap; race it for more laps"),
        (["elsewhere", "paper:rl"], "elsewhere, paper:rl: were driven on different tracks"),
    ],
)
def test_what_cannot_be_compared_is_said_in_one_line(words, said, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("empty").mkdir()
    RunFolder.start(Path("report"), "report", {}).finish()
    raced(Path("crashed"), human_lap(), most=0)
    raced(Path("elsewhere"), human_lap(), replace(TRACK, x=TRACK.x + 1.0))
    with pytest.raises(RacerlError) as error:
        run_command("compare", [*words, "out=compared"], compare, positional="drivers")
    assert said in str(error.value) and "\n" not in str(error.value)
    assert not Path("compared").exists()
