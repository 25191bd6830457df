"""Tables through mappings: round trips, units, frames, shifts, gaps; the measured logs; bad files in one line."""

import gzip
import re

import numpy as np
import pandas as pd
import pytest

from racerl.data.load import load_logs, load_measured
from racerl.errors import LogError
from tests.data.conftest import mapping, measured


def load(path, name="drive_log", **changes):
    return load_logs([path], {**mapping(name), **changes})[0]


def save(table, path):
    table.to_parquet(path) if path.suffix == ".parquet" else table.to_csv(path, index=False)
    return path


@pytest.mark.parametrize("name", ["a.csv", "a.csv.gz", "a.parquet"])
def test_round_trip(driven, tmp_path, name):
    log = load(save(driven, tmp_path / name))
    assert log.name == name and log.remarks == ()
    pd.testing.assert_frame_equal(log.table[driven.columns], driven, rtol=1e-12, check_dtype=False)


def test_units_signs_and_clocks_are_converted(driven, tmp_path):
    foreign = pd.DataFrame(
        {"ms": driven["t"] * 1e3 + 1.7e12, "steer": -np.degrees(driven["delta"]), "speed": driven["v_x"] * 3.6}
    )
    changes = {
        "time": {"column": "ms", "scale": 1e-3},
        "channels": {
            "delta": {"column": "steer", "scale": -np.pi / 180},
            "v_x": {"column": "speed", "scale": 1 / 3.6},
        },
    }
    log = load(save(foreign, tmp_path / "a.csv"), **changes)
    np.testing.assert_allclose(log.array("delta"), driven["delta"], atol=1e-9)
    np.testing.assert_allclose(log.array("v_x"), driven["v_x"], atol=1e-9)
    assert len(list(log.runs())) == 3 and log.dt == 0.01 and any("t counts from" in r for r in log.remarks)


def test_columns_that_carry_no_channels_name_are_told(driven, tmp_path):
    said = load(save(driven.rename(columns={"yaw_rate": "YawRate", "delta_ref": "steer"}), tmp_path / "a.csv")).remarks
    assert "columns that no channel is called after are not read: YawRate (yaw_rate?), steer" in said
    many = {f"wheel_{k}": 0.0 for k in range(20)}
    said = load(save(driven.assign(**many), tmp_path / "b.csv")).remarks
    assert any(line.endswith("wheel_7 and 12 more") for line in said)


def test_velocities_come_from_poses_where_absent(driven, tmp_path):
    log = load(save(driven.drop(columns=["v_x", "v_y", "yaw_rate"]), tmp_path / "a.csv"))
    assert any("differentiated" in remark for remark in log.remarks)
    for name in ("v_x", "yaw_rate"):
        assert np.corrcoef(log.array(name), driven[name])[0, 1] > 0.97


VELOCITIES = ["v_x", "v_y", "yaw_rate"]


def late(table, names, rows):
    return table.assign(**{n: table.groupby("run")[n].shift(rows).bfill() for n in names})


def test_velocities_that_come_late_are_made_from_the_poses_and_one_line_says_so(driven, tmp_path):
    path = save(late(driven, VELOCITIES, 7), tmp_path / "a.csv")
    log = load(path)
    assert "come 0.070 s after the poses" in log.remarks[0] and "data.velocities=columns" in log.remarks[0]
    pd.testing.assert_frame_equal(log.table, load(path, velocities="poses").table)
    assert np.corrcoef(log.array("yaw_rate"), driven["yaw_rate"])[0, 1] > 0.97
    kept = load(path, velocities="columns")
    assert kept.remarks == () and np.array_equal(kept.array("v_x"), pd.read_csv(path)["v_x"])


def test_velocities_of_another_point_are_made_from_the_poses_and_one_line_says_where_it_is(driven, tmp_path):
    log = load(save(driven.assign(v_y=driven["v_y"] - 0.15 * driven["yaw_rate"]), tmp_path / "a.csv"))
    assert re.search(r"belong to a point 0\.1[456] m behind theirs", log.remarks[0])
    assert np.corrcoef(log.array("v_y"), driven["v_y"])[0, 1] > 0.9


@pytest.mark.parametrize("rows", [1, 10])
def test_velocities_stand_where_it_is_the_poses_that_are_late_or_slow(driven, tmp_path, rows):
    poses = ["x", "y", "yaw"]
    held = {n: driven.groupby("run")[n].transform(lambda c: np.repeat(c.to_numpy()[::rows], rows)) for n in poses}
    log = load(save(late(driven.assign(**held), poses, 5), tmp_path / "a.csv"))
    np.testing.assert_array_equal(log.array("v_y"), driven["v_y"])


def test_a_tracked_point_is_moved_to_the_centre_of_gravity(tmp_path):
    t = np.arange(0.0, 10.0, 0.01)
    angle = 0.8 * t
    # the centre drives a circle of 2 m without slip; the marker sits 0.3 m ahead, 0.1 m left, turned by −0.05 rad
    yaw = angle + np.pi / 2
    x, y = 2 * np.cos(angle), 2 * np.sin(angle)
    marker = pd.DataFrame(
        {
            "t": t,
            "x": x + 0.3 * np.cos(yaw) - 0.1 * np.sin(yaw),
            "y": y + 0.3 * np.sin(yaw) + 0.1 * np.cos(yaw),
            "yaw": np.angle(np.exp(1j * (yaw - 0.05))),
        }
    )
    log = load(save(marker, tmp_path / "a.csv"), frame={"forward": 0.3, "left": 0.1, "yaw": 0.05})
    np.testing.assert_allclose(log.array("x"), x, atol=1e-9)
    np.testing.assert_allclose(log.array("v_x"), 1.6, atol=1e-3)
    np.testing.assert_allclose(log.array("v_y"), 0.0, atol=1e-3)


def test_a_shift_moves_a_channel_in_time(driven, tmp_path):
    early = driven.copy()
    early["omega"] = np.concatenate([early["omega"][7:], np.full(7, early["omega"].iloc[-1])])
    log = load(save(early, tmp_path / "a.csv"), shift={"omega": 0.07})
    rows = log.table[log.table["run"] == 0].merge(driven, on=["run", "t"], suffixes=("", "_true"))
    np.testing.assert_allclose(rows["omega"].iloc[10:-10], rows["omega_true"].iloc[10:-10], atol=1e-9)


def test_uneven_samples_are_resampled_and_commands_are_held(tmp_path):
    dice = np.random.default_rng(1)
    t = np.cumsum(dice.uniform(0.008, 0.012, 1000))
    table = pd.DataFrame({"t": t, "v_x": 2 + np.sin(t), "delta_ref": np.floor(t * 4) / 100})
    log = load(save(table, tmp_path / "a.csv"), run=None, resample=50)
    assert log.dt == 0.02
    np.testing.assert_allclose(log.array("v_x"), 2 + np.sin(log.array("t")), atol=1e-4)
    assert set(np.round(log.array("delta_ref") * 100, 9) % 1) == {0.0}


def test_gaps_and_leaps_cut_runs_and_short_ones_are_dropped(tmp_path):
    t = np.arange(0.0, 10.0, 0.01)
    table = pd.DataFrame({"t": t, "x": 1.0 * t, "y": 0 * t, "yaw": 0 * t})
    table.loc[700:, "x"] += 5.0  # the tracker loses the car and finds it elsewhere
    table = table.drop(index=[*range(200, 260), *range(265, 300)])
    log = load(save(table, tmp_path / "a.csv"), run=None)
    assert len(list(log.runs())) == 3
    assert any("jumps" in r for r in log.remarks) and any("shorter than" in r for r in log.remarks)
    np.testing.assert_allclose(log.array("v_x"), 1.0, atol=1e-9)


@pytest.mark.parametrize("name, size", [("x", 0.3), ("y", -0.05), ("yaw", 0.5)])
def test_a_spike_in_a_pose_is_replaced(driven, tmp_path, name, size):
    poses = driven.drop(columns=["v_x", "v_y", "yaw_rate"])
    whole = load(save(poses, tmp_path / "a.csv"))
    poses.loc[1000, name] += size
    log = load(save(poses, tmp_path / "b.csv"))
    assert any("stuck out" in r for r in log.remarks) and not any("stuck out" in r for r in whole.remarks)
    np.testing.assert_allclose(log.array("v_x"), whole.array("v_x"), atol=0.1)
    np.testing.assert_allclose(log.array("yaw_rate"), whole.array("yaw_rate"), atol=0.1)


def test_only_required_rows_count(driven, tmp_path):
    table = driven.assign(safe=(driven["run"] != 1).astype(float))
    log = load(save(table, tmp_path / "a.csv"), require={"safe": 1})
    assert set(log.table["run"]) == {0, 2} and "require" in log.remarks[0]


@pytest.mark.parametrize(
    "file, name, rows, runs",
    [
        ("put/lab_drive.csv.gz", "put", 13253, 10),
        ("put/tyre_a.csv.gz", "put", 14867, 7),
        ("put/tyre_d.csv.gz", "put", 10125, 3),
        ("dart/free_driving_10_02_28.csv.gz", "dart", 9153, 1),
        ("dart/steering_steps_10_02_32.csv.gz", "dart", 1406, 2),
    ],
)
def test_measured_logs(file, name, rows, runs):
    log = load(measured(file), name)
    assert (len(log.table), log.table["run"].nunique(), log.dt) == (rows, runs, 0.01)


def test_dart_drives_where_its_nose_points():
    """The mapping's frame is right when slip angles are small on straights, and its steering when curves fit."""
    log = load(measured("dart/free_driving_10_01_01.csv.gz"), "dart")
    v_x, v_y, r, steer = (log.array(name) for name in ("v_x", "v_y", "yaw_rate", "delta_ref"))
    straight = (v_x > 0.8) & (np.abs(r) < 0.15)
    assert abs(np.median(v_y[straight] / v_x[straight])) < 0.005
    curve = (v_x > 0.5) & (np.abs(steer) > 0.2)
    assert np.median(np.arctan(0.1735 * r[curve] / v_x[curve]) / steer[curve]) == pytest.approx(1.0, abs=0.15)


def test_a_wrong_mapping_names_the_likely_one(driven, tmp_path):
    with pytest.raises(LogError, match="looks like data=drive_log"):
        load(save(driven, tmp_path / "a.csv"), "dart")
    foreign = driven.rename(columns={"t": "vicon time", "x": "vicon x", "y": "vicon y", "yaw": "vicon yaw"})
    with pytest.raises(LogError, match="looks like data=dart"):
        load(save(foreign, tmp_path / "b.csv"))
    with pytest.raises(LogError, match="write a mapping"):
        load(save(driven.add_prefix("my_"), tmp_path / "c.csv"))
    with pytest.raises(LogError, match="is no bag"):
        load(tmp_path / "a.csv", "ros2")


@pytest.mark.parametrize(
    "name, content, said",
    [
        ("a.csv", b"", "cannot be read"),
        ("a.csv", b"t,v_x\n", "0 rows"),
        ("a.csv", b"\x00\x01\x02" * 50, "zero bytes|no text|cannot be read"),
        ("a.csv", b"t,v_x\n0,1\n0.01,1\n0.02,x\n", "not numeric"),
        ("a.csv", b"t,v_x\n0,1,5\n0.01,1,2\n", "cannot be read"),
        ("a.csv", b"t,v_x\n0,1\n0.01,1,2\n", "line 3 has 3 numbers, those before it 2"),
        ("a.csv", b"t,x, x \n0,1,2\n0.01,1,2\n", "has the column 'x' twice"),
        ("a.csv", b"t;x\n0;1\n", "columns are parted by ';'"),
        ("a.csv", b"t\tx\n0\t1\n", "columns are parted by tabs"),
        ("a.csv", "t,stra\u00dfe\n0,1\n".encode("latin-1"), "no UTF-8 text .byte 6."),
        ("a.csv", "# a car\nt,stra\u00dfe\n0,1\n".encode("latin-1"), "no UTF-8 text .byte 14."),
        ("a.csv", b"t," + b"a," * 5000 + b"\n", "no header"),
        ("a.csv.gz", b"no gzip", "cannot be read"),
        ("a.csv.gz", gzip.compress(b"t,v_x\n" + b"0,1\n" * 1000, mtime=0)[:-20], "cannot be read"),
        ("a.parquet", b"PAR1nonsensePAR1", "cannot be read"),
        ("a.txt", b"t,v_x\n0,1\n", "is no log"),
    ],
)
def test_bad_files_are_one_line(tmp_path, name, content, said):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(LogError, match=said) as error:
        load(tmp_path / name)
    assert "\n" not in str(error.value)


def test_a_gzip_bomb_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("racerl.data.load.MAX_BYTES", 1_000_000)
    (tmp_path / "a.csv.gz").write_bytes(gzip.compress(b"t,v_x\n" + b"0,1\n" * 1_000_000))
    with pytest.raises(LogError, match="when unpacked"):
        load(tmp_path / "a.csv.gz")


def test_a_missing_file_is_one_line(tmp_path):
    with pytest.raises(LogError, match="no such file"):
        load(tmp_path / "a.csv")


def test_poses_that_come_too_seldom_are_told_in_tables_too(driven, tmp_path):
    said = {step: load(save(driven.iloc[::step], tmp_path / f"{step}.csv")).remarks for step in (1, 3, 20)}
    assert not any("too seldom" in line for step in (1, 3) for line in said[step])
    assert any(line.startswith("the pose comes 5 times per second, too seldom") for line in said[20])


def turning(t, speed=2.0, rate=0.3):
    """Return the poses of a car on a circle at times t in s."""
    yaw = rate * t
    return pd.DataFrame({"t": t, "x": speed / rate * np.sin(yaw), "y": speed / rate * (1.0 - np.cos(yaw)), "yaw": yaw})


@pytest.mark.parametrize(
    "t",
    [
        np.arange(2000)[np.arange(2000) % 100 > 5] * 0.01,  # 60 ms are missing each second
        np.arange(2000) * 0.01 + 0.0009 * np.sin(np.arange(2000.0)),
    ],
    ids=["dropouts", "jitter"],
)
def test_velocities_from_poses_at_uneven_times_are_those_of_the_car(tmp_path, t):
    log = load(save(turning(t), tmp_path / "a.csv"))
    np.testing.assert_allclose(log.array("v_x"), 2.0, atol=0.01)
    np.testing.assert_allclose(log.array("yaw_rate"), 0.3, atol=0.003)
    assert any("sampled at 100 Hz" in line for line in log.remarks)


def test_poses_that_come_in_pairs_are_refused_with_what_to_give(tmp_path):
    pairs = np.sort(np.concatenate([0.04 * np.arange(500), 0.04 * np.arange(500) + 0.0002]))
    path = save(turning(pairs), tmp_path / "a.csv")
    with pytest.raises(LogError, match=r"50% of its steps are not its usual .*: data\.resample=50"):
        load(path)
    np.testing.assert_allclose(load(path, resample=50).array("v_x"), 2.0, atol=0.01)


def test_poses_of_a_table_that_move_along_their_heading_are_reckoned(driven, tmp_path):
    reckoned = turning(np.arange(2000) * 0.01).assign(v_x=2.0, v_y=0.0, yaw_rate=0.3)
    path = save(reckoned, tmp_path / "a.csv")
    gap = reckoned.assign(yaw=reckoned["yaw"].where(reckoned.index != 3))
    assert load(save(gap, tmp_path / "c.csv")).reckoned
    assert load(path).reckoned and not load(save(driven, tmp_path / "b.csv")).reckoned
    with pytest.raises(LogError, match="reckoned from wheel and steering"):
        load_measured({"logs": [str(path)], "data": mapping("drive_log")})


def test_an_empty_column_is_left_out_and_a_sparse_one_is_named(driven, tmp_path):
    log = load(save(driven.assign(current=np.nan), tmp_path / "a.csv"))
    assert "current" not in log.channels and "current is no number in any row: untestable" in log.remarks
    sparse = driven.assign(current=np.where(np.arange(len(driven)) % 3, 1.0, np.nan))
    with pytest.raises(LogError, match="33% of the rows miss a value, most of them current"):
        load(save(sparse, tmp_path / "b.csv"))
    with pytest.raises(LogError, match="most of them run"):
        load(save(driven.assign(run=driven["run"].where(driven.index % 3 > 0)), tmp_path / "d.csv"))
    with pytest.raises(LogError, match="no number in any column"):
        load(save(driven[["t"]].assign(v_x=np.nan), tmp_path / "c.csv"))


def test_a_flag_may_be_required(driven, tmp_path):
    flagged = driven.assign(autonomous=driven["run"] == 1)
    assert len(load(save(flagged, tmp_path / "a.csv"), require={"autonomous": 1}).table) == 2000


@pytest.mark.parametrize("held, expected", [(True, [0.0, 0.0, 0.01, 0.01]), (False, [0.0, 0.005, 0.01, 0.015])])
def test_the_column_that_is_read_says_whether_it_is_held(tmp_path, held, expected):
    table = pd.DataFrame({"t": 0.02 * np.arange(50), "b": 0.01 * np.arange(50.0)})
    sources = [{"column": "a", "hold": not held}, {"column": "b", "hold": held}]
    log = load(save(table, tmp_path / "a.csv"), channels={"delta": sources}, resample=100)
    assert log.array("delta")[:4] == pytest.approx(expected)


def test_commands_that_are_logged_when_they_change_count_until_the_next(driven, tmp_path):
    fresh = driven["delta_ref"].diff().fillna(1.0) != 0.0
    first = driven["run"].diff().fillna(1.0) != 0.0  # nothing goes on from the run before
    changes = driven.assign(delta_ref=driven["delta_ref"].where(fresh | first))
    np.testing.assert_array_equal(load(save(changes, tmp_path / "a.csv")).array("delta_ref"), driven["delta_ref"])
    without = driven.assign(delta_ref=driven["delta_ref"].where(driven["run"] > 0))
    assert set(load(save(without, tmp_path / "b.csv")).table["run"]) == {1, 2}


@pytest.mark.parametrize("size", [0.1, 0.5])
def test_a_pose_that_jumps_for_good_cuts_the_run(driven, tmp_path, size):
    away = np.where(np.arange(len(driven)) > 700, size, 0.0)
    jumped = driven[["t", "run", "x", "y", "yaw", "omega"]].assign(x=driven["x"] + away)
    log = load(save(jumped, tmp_path / "a.csv"))
    usual = load(save(jumped.assign(x=driven["x"]), tmp_path / "b.csv"))
    assert "the position jumps at 1 rows; runs are split there" in log.remarks
    assert log.array("v_x").max() < usual.array("v_x").max() + 0.2 and usual.remarks == log.remarks[1:]


@pytest.mark.parametrize("how", ["a comment above", "a header with a #"])
def test_lines_above_the_header_are_no_rows(driven, tmp_path, how):
    text = driven.to_csv(index=False)
    path = tmp_path / "a.csv"
    path.write_text("# recorded on Monday\n# by car 3\n" + text if how == "a comment above" else "# " + text)
    assert len(load(path).table) == len(driven)


def test_dates_are_times(driven, tmp_path):
    dated = driven.assign(t=pd.Timestamp("2026-03-01T10:00:00Z") + pd.to_timedelta(driven["t"], unit="s"))
    for name in ("a.csv", "a.parquet"):
        log = load(save(dated, tmp_path / name))
        assert log.dt == 0.01 and len(log.table) == len(driven)


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda t: t.sample(frac=1.0, random_state=0), "sort its rows by t"),
        (lambda t: t.assign(t=t["t"].round(1)), "stamps are too coarse"),
        (lambda t: t.assign(t=1e3 * t["t"]), "another unit. data.time.scale=0.001 for ms"),
        (lambda t: t.rename(columns={"t": "Time"}), "data.time.column=Time takes that one"),
        (lambda t: t.assign(x=t["x"].astype(str).where(t.index != 7, "--")), r"row 8: '--'"),
    ],
)
def test_what_is_wrong_with_a_table_is_said_with_a_cure(driven, tmp_path, spoil, said):
    with pytest.raises(LogError, match=said):
        load(save(spoil(driven.drop(columns="run")[:2000]), tmp_path / "a.csv"))
