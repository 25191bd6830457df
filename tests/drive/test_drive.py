"""Whole drives under SDL's dummy driver, by the script and by keys that are posted."""

import json
import os
import signal
import sys

import numpy as np
import pandas as pd
import pygame
import pytest
from pygame.event import Event

from racerl.config import compose_settings
from racerl.data.load import load_given, load_logs
from racerl.drive.drive import BAG, LOG, drive
from racerl.drive.screen import Screen
from racerl.drive.seat import Seat
from racerl.errors import ConfigError, RacerlError, RunError
from racerl.evaluate.evaluate import evaluate
from racerl.report.report import report
from racerl.run import RunFolder, is_complete

CURRENT = "sim=motor_current"


def driven(out, *words):
    return drive(compose_settings("drive", words), out)


@pytest.fixture(scope="module")
def scripted(tmp_path_factory):
    """Two counted laps with motor currents; tests must not change it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SDL_VIDEODRIVER", "dummy")
        out = tmp_path_factory.mktemp("drive") / "outputs" / "drive" / "first"
        return driven(out, "input=script", "laps=2", CURRENT), out


def act_at(monkeypatch, actions):
    """Call actions, by number of the frame, as the window is drawn; keys are posted as a person would press them."""
    frames, draw = [], Screen.draw

    def counted(screen, picture):
        frames.append(picture)
        actions.get(len(frames), lambda: None)()
        draw(screen, picture)

    monkeypatch.setattr(Screen, "draw", counted)
    monkeypatch.setattr(Screen, "wait", lambda screen, dt: None)
    return frames


def key(code, kind=pygame.KEYDOWN):
    return lambda: pygame.event.post(Event(kind, key=code))


def test_a_scripted_drive_leaves_what_an_evaluation_leaves(scripted, smoke_evaluation):
    metrics, out = scripted
    theirs = json.loads((smoke_evaluation / "metrics.json").read_text())
    assert set(theirs) - set(metrics) == {"run", "run_id", "trained"}
    assert metrics == json.loads((out / "metrics.json").read_text())
    assert metrics["laps"] == metrics["valid_laps"] == metrics["laps_wanted"] == 2
    assert metrics["label"] == metrics["controller"] == "script" and metrics["drive_mode"] == "motor_current"
    assert set(pd.read_csv(out / "track.csv")) == set(pd.read_csv(smoke_evaluation / "track.csv"))
    rows, others = (pd.read_parquet(path / "trajectories.parquet") for path in (out, smoke_evaluation))
    assert set(rows) ^ set(others) == {"current", "omega_ref"}
    assert set(rows.loc[rows["lap"] > 0, "lap"]) == {1, 2, 3} and (rows["lap"] == 3).sum() == 1  # the last crossing
    assert RunFolder.open_complete(out, "drive").manifest["log"] == LOG


def test_the_bag_read_back_is_the_log(scripted):
    _, out = scripted
    log, mapping = pd.read_parquet(out / LOG), compose_settings("data", ["logs=[x]", "data=f1tenth"])["data"]
    (back,) = load_logs([out / BAG], mapping)
    runs = back.table.groupby("run")
    assert len(runs) == log["run"].nunique() == 2
    for run, rows in log.groupby("run"):
        read = runs.get_group(run).iloc[::2]  # bags are read at 100 Hz
        assert len(read) == len(rows)
        for channel in ("x", "y", "omega", "delta_ref", "current"):
            np.testing.assert_allclose(read[channel], rows[channel], atol=1e-6, err_msg=channel)


def test_the_log_is_a_drive_log_with_the_practice(scripted):
    _, out = scripted
    (log,) = load_given({"logs": str(out / LOG), "data": compose_settings("evaluate", ["run=x"])["data"]})
    assert log.dt == 0.02 and log.remarks == () and {"current", "delta_ref", "yaw", "omega"} <= set(log.channels)
    table = pd.read_parquet(out / LOG)
    assert list(table.groupby("run")["manoeuvre"].unique().map(list)) == [["practice"], ["counted"]]
    assert np.abs(table["current"]).max() == 30.0  # the limit that conf/drive.yaml sets
    driven_rows = table[table["run"] == 1]
    way = np.hypot(driven_rows["x"].diff(), driven_rows["y"].diff()).sum()
    assert way == pytest.approx(2 * 17.5, rel=0.08)


def test_the_log_scores_as_the_drive(scripted, tmp_path):
    metrics, out = scripted
    again = evaluate(compose_settings("evaluate", [f"run='{out / LOG}'", "track=l_shape"]), tmp_path / "log")
    assert [row["time_s"] for row in again["rows"]] == pytest.approx(
        [row["time_s"] for row in metrics["rows"]], abs=1e-3
    )
    assert again["e_off"] == pytest.approx(metrics["e_off"], abs=1e-5)


def test_the_report_has_the_row(scripted, smoke_evaluation, tmp_path):
    metrics, out = scripted
    words = compose_settings("report", [f"runs=['{out}','{smoke_evaluation}']"])
    page = report(words, tmp_path / "page", tmp_path / "nothing").read_text()
    assert "script" in page and f"{metrics['mean_lap_s']:.3f}" in page
    everything = report(compose_settings("report", []), tmp_path / "all", out.parent.parent).read_text()
    assert "script" in everything


@pytest.mark.parametrize(
    "words", [["car=twin", CURRENT], pytest.param(["car=twin"], marks=pytest.mark.slow)], ids=" ".join
)
def test_the_twin_is_driven_in_both_modes(words, tmp_path):
    metrics = driven(tmp_path / "out", "input=script", "laps=1", *words)
    assert metrics["car"] == "twin" and metrics["valid_laps"] == 1 and metrics["nan_cars"] == 0
    command = {"current", "omega_ref"} & set(pd.read_parquet(tmp_path / "out" / LOG))
    assert command == ({"current"} if CURRENT in words else {"omega_ref"})


def test_the_same_script_drives_the_same_laps(scripted, tmp_path):
    again = driven(tmp_path / "again", "input=script", "laps=2", CURRENT)
    assert again["rows"] == scripted[0]["rows"]


def test_a_person_s_drive_is_called_human_and_closing_keeps_it(tmp_path, monkeypatch):
    frames = act_at(
        monkeypatch,
        {
            10: key(pygame.K_UP),
            40: key(pygame.K_RETURN),
            400: lambda: pygame.event.post(Event(pygame.QUIT)),
        },
    )
    metrics = driven(tmp_path / "out", "input=keyboard")  # straight on at full throttle, off the track
    assert metrics["label"] == "human" and metrics["controller"] == "keyboard"
    assert 0 < metrics["laps"] < metrics["laps_wanted"] == 20 and metrics["crash_share"] == 1.0
    assert [row["time_s"] for row in metrics["rows"]] == [None] * metrics["laps"]
    assert {frames[0].title, frames[-1].title} == {"practice", f"lap {metrics['laps'] + 1} of 20"}
    log = pd.read_parquet(tmp_path / "out" / LOG)
    assert log["run"].nunique() == 1 + metrics["laps"] + 1 and is_complete(tmp_path / "out")
    # it waits for the throttle; after each crash it stands on the centreline again
    assert len(log) == 401 - 10 + 1
    starts = log.groupby("run").first().drop(index=1)  # the counted session begins on the way
    assert np.abs(starts[["n", "v_x", "omega"]]).max().max() < 0.02


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_asked_to_end_it_keeps_what_was_driven(tmp_path, monkeypatch, number):
    act_at(monkeypatch, {10: key(pygame.K_UP), 60: lambda: os.kill(os.getpid(), number)})
    assert driven(tmp_path / "out", "input=keyboard") is None  # no counted lap
    assert len(pd.read_parquet(tmp_path / "out" / LOG)) > 30


def test_being_put_back_costs_the_counted_lap(tmp_path, monkeypatch):
    act_at(
        monkeypatch,
        {
            1: key(pygame.K_UP),
            30: key(pygame.K_RETURN),
            35: key(pygame.K_r),
            40: key(pygame.K_ESCAPE),
        },
    )
    metrics = driven(tmp_path / "out", "input=keyboard")
    assert metrics["laps"] == 1 and metrics["rows"][0]["crashed"]


def test_a_pause_is_not_driven(tmp_path, monkeypatch):
    actions = {1: key(pygame.K_UP), 20: key(pygame.K_p), 60: key(pygame.K_p), 80: key(pygame.K_ESCAPE)}
    frames = act_at(monkeypatch, actions)
    assert driven(tmp_path / "out", "input=keyboard") is None
    assert {frame.message for frame in frames[25:55]} == {"paused"}
    assert len({(frame.x, frame.y) for frame in frames[25:55]}) == 1
    assert np.allclose(pd.read_parquet(tmp_path / "out" / LOG)["t"].diff().dropna(), 0.02)


def test_without_a_counted_lap_only_the_log_and_its_bag_are_written(tmp_path, monkeypatch):
    act_at(monkeypatch, {1: key(pygame.K_UP), 30: lambda: os.kill(os.getpid(), signal.SIGINT)})
    handler = signal.getsignal(signal.SIGINT)
    out = tmp_path / "outputs" / "drive" / "out"
    assert driven(out, "input=keyboard") is None and signal.getsignal(signal.SIGINT) is handler
    assert {path.name for path in out.iterdir()} == {LOG, BAG, "manifest.json", "config.yaml"}
    assert load_given({"logs": str(out / LOG), "data": compose_settings("evaluate", ["run=x"])["data"]})
    with pytest.raises(RunError, match="already holds a drive"):
        driven(out, "input=keyboard")
    with pytest.raises(RunError, match="no finished run"):
        report(compose_settings("report", []), tmp_path / "page", tmp_path / "outputs")


def test_leaving_at_once_writes_nothing(tmp_path, monkeypatch):
    act_at(monkeypatch, {1: key(pygame.K_ESCAPE)})
    assert driven(tmp_path / "out", "input=keyboard") is None and not (tmp_path / "out" / LOG).exists()


def test_every_frame_shows_the_car_where_it_is(tmp_path, monkeypatch):
    """Pixels in the car's colour move with it, and the wheels that steer are drawn steered."""
    places = []

    class Watched(Seat):
        def step(self):
            super().step()
            picture = self.picture()
            self.screen.draw(picture)
            pixel = self.screen._pixel(picture.x, picture.y)
            places.append(pixel)
            assert self.screen.surface.get_at((round(pixel.x), round(pixel.y)))[:3] == (78, 148, 236)
            self.over = len(places) == 50

    monkeypatch.setattr("racerl.drive.seat.Seat", Watched)
    driven(tmp_path / "out", "input=script")
    assert places[0].distance_to(places[-1]) > 40.0


def test_without_pygame_one_line_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pygame", None)
    with pytest.raises(ConfigError, match=r"^racerl drive needs pygame: in your clone, pip install -e '\.\[drive\]'$"):
        driven(tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "words, said",
    [
        (["laps=0"], "laps"),
        (["seed=-1"], "seed"),
        (["current_limit=0"], "current_limit"),
        (["input=hands"], "unknown input 'hands'"),
        (["sim.dt=0.025"], "multiple"),
        (["sim.drive=steam"], "sim.drive is steam"),
        ([CURRENT, "sim.actuators=false"], "has no motor"),
    ],
)
def test_mistakes_are_one_line_and_leave_nothing(words, said, tmp_path):
    with pytest.raises(RacerlError, match=said) as error:
        driven(tmp_path / "out", *words)
    assert "\n" not in str(error.value) and not (tmp_path / "out").exists()
