"""Racelines in the TUM format: what is written is read, and what others write is read as well."""

import numpy as np
import pandas as pd
import pytest

from racerl.config import compose_settings
from racerl.errors import RacerlError, TrackError
from racerl.evaluate.evaluate import evaluate
from racerl.report.compare import compare
from racerl.track.load import read_track
from racerl.track.raceline import COLUMNS, drive_along, is_raceline, raceline_text, read_raceline
from tests.conftest import CONF

ABOUT = "racerl", "of a test"
TRACK = read_track(CONF / "track" / "l_shape.csv")


def a_line(speed=2.0):
    """The centreline of the default track, at a speed."""
    s = np.arange(len(TRACK.x)) * TRACK.spacing
    psi = TRACK.yaw - np.pi / 2
    zero = np.zeros(len(s))
    return pd.DataFrame(
        dict(zip(COLUMNS, (s, TRACK.x, TRACK.y, psi, TRACK.curvature, zero + speed, zero), strict=True))
    )


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "line.csv"
    path.write_text(raceline_text(a_line(), TRACK.length, ABOUT))
    return path


def test_what_is_written_and_read_is_the_same_line(file, tmp_path):
    line = read_raceline(file)
    pd.testing.assert_frame_equal(line, a_line(), atol=1e-7, rtol=0)
    file.write_text(raceline_text(line, TRACK.length, ABOUT))
    pd.testing.assert_frame_equal(read_raceline(file), line, atol=0, rtol=0)


def test_others_read_it_below_three_rows(file):
    table = np.loadtxt(file, delimiter=";", skiprows=3)
    assert table.shape == (len(TRACK.x) + 1, 7) and np.array_equal(table[0, 1:], table[-1, 1:])
    assert table[-1, 0] == pytest.approx(TRACK.length, abs=1e-6)
    assert file.read_text().splitlines()[2] == "# s_m; x_m; y_m; psi_rad; kappa_radpm; vx_mps; ax_mps2"


@pytest.mark.parametrize(
    "change",
    [
        lambda text: text.replace("# racerl\n# of a test\n", "# 5f0b\n#77aa\n"),
        lambda text: "".join(text.splitlines(keepends=True)[3:]),  # no header
        lambda text: text.replace("# s_m", "s_m"),
        lambda text: "\ufeff" + text.replace("\n", "\r\n"),
        lambda text: text.replace("; ", ";"),
        lambda text: text.replace("; ", ", "),
        lambda text: text.replace("\n", " # the end of a row\n", 9),
        lambda text: text.replace("\n", "\n\n"),
    ],
)
def test_what_others_write_is_read(file, change):
    file.write_text(change(file.read_text()), encoding="utf-8", newline="")
    pd.testing.assert_frame_equal(read_raceline(file), a_line(), atol=1e-7, rtol=0)
    assert is_raceline(file)


def test_columns_are_told_by_their_names(file):
    rows = [f"{y:.6f}; {x:.6f}; 1; 2.5" for x, y in zip(TRACK.x, TRACK.y, strict=True)]
    file.write_text("# y_m; x_m; banking; vx_mps\n" + "\n".join(rows))
    line = read_raceline(file)
    assert [*line] == ["x_m", "y_m", "vx_mps"] and np.allclose(line["x_m"], TRACK.x, atol=1e-6)


@pytest.mark.parametrize(
    "content, said",
    [
        ("", "no TUM raceline"),
        ("x,y\n1,2\n", "no TUM raceline"),
        ("1;2;3;4;5;6;7;8\n" * 20, "no TUM raceline"),  # another format
        ("# s_m; x_m; y_m; psi_rad; kappa_radpm; vx_mps; ax_mps2\n1;2;3\n", "7 numbers in each row"),
        ("1;2;3;4;5;6;7\n1;2;3;4;5;6;seven\n", "7 numbers in each row"),
        ("1;2;3;4;5;6;7\n1;2\n", "7 numbers in each row"),
        ("1;2;3;4;5;6;7\n" * 20, "10 points or more"),
        ("1;nan;3;4;5;6;7\n" * 20, "10 points or more"),
    ],
)
def test_what_is_none_is_told_in_one_line(tmp_path, content, said):
    (tmp_path / "line.csv").write_text(content)
    with pytest.raises(TrackError, match=said) as error:
        read_raceline(tmp_path / "line.csv")
    assert "\n" not in str(error.value)


def test_a_standing_car_makes_no_line(file):
    file.write_text(raceline_text(a_line(speed=0.0), TRACK.length, ABOUT))
    with pytest.raises(TrackError, match="positive speeds"):
        read_raceline(file)


@pytest.mark.parametrize("text", ["t,x,y,yaw,v_x\n0,0,0,0,1\n", "t x y yaw v_x delta omega\n0 0 0 0 1 0 1\n", ""])
def test_a_drive_log_is_no_raceline(tmp_path, text):
    (tmp_path / "log.csv").write_text(text)
    assert not is_raceline(tmp_path / "log.csv") and not is_raceline(tmp_path / "nowhere.csv")


def test_a_drive_along_it_takes_its_time():
    drive = drive_along(a_line(speed=3.0), 2.0, 100.0)
    assert drive["t"].iloc[-1] == pytest.approx(2 * TRACK.length / 3.0, abs=0.02)
    way = np.hypot(np.diff(drive["x"]), np.diff(drive["y"])).sum()
    assert way == pytest.approx(2 * TRACK.length, rel=5e-3)
    turned = drive["yaw"].iloc[-1] - drive["yaw"].iloc[0]
    assert turned == pytest.approx(-4 * np.pi, abs=0.1)  # clockwise, twice


def test_a_raceline_is_scored_and_set_beside_a_driver(file, tmp_path):
    file.write_text(raceline_text(a_line(speed=6.0), TRACK.length, ABOUT))
    settings = compose_settings("evaluate", [f"run='{file}'", "track=l_shape"])
    metrics = evaluate(settings, tmp_path / "line")
    assert metrics["valid_laps"] >= 1 and metrics["e_off"] == 0.0 and metrics["crash_share"] == 0.0
    assert metrics["mean_lap_s"] == pytest.approx(TRACK.length / 6.0, rel=2e-3)
    page = compare({"drivers": [str(tmp_path / "line"), "paper:rl"]}, tmp_path / "duel")
    assert "line.csv" in page.read_text() and (tmp_path / "duel" / "compare.svg").is_file()
    with pytest.raises(RacerlError, match="say on which track"):
        evaluate(compose_settings("evaluate", [f"run='{file}'"]), tmp_path / "nowhere")


def test_points_that_stand_twice_count_once_and_columns_may_not(file, tmp_path):
    line, rows = read_raceline(file), file.read_text().splitlines()
    head, points = rows[:3], rows[3:]
    (tmp_path / "twice.csv").write_text("\n".join([*head, points[0], *points, points[-1]]) + "\n")
    pd.testing.assert_frame_equal(read_raceline(tmp_path / "twice.csv").reset_index(drop=True), line, atol=1e-6)
    assert len(drive_along(read_raceline(tmp_path / "twice.csv"), 1.0, 50.0))
    (tmp_path / "names.csv").write_text("x_m;y_m;vx_mps;x_m\n" + "\n".join(f"{k};{k};1;1" for k in range(20)))
    with pytest.raises(TrackError, match="no TUM raceline"):
        read_raceline(tmp_path / "names.csv")


def test_three_columns_make_one(tmp_path):
    (tmp_path / "line.csv").write_text("# x_m;y_m;vx_mps\n" + "\n".join(f"{k};{k * k};1" for k in range(20)))
    assert is_raceline(tmp_path / "line.csv") and len(read_raceline(tmp_path / "line.csv")) == 20
