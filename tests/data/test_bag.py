"""Bags: both storages, splits, zips; the measured one; damaged ones in one line."""

import shutil
import sqlite3
import time
import zipfile

import numpy as np
import pytest

from racerl.data.bag import MAX_RATIO, SMALL
from racerl.data.load import load_logs
from racerl.errors import LogError
from tests.data.conftest import mapping, measured, write_bag


def load(path, **changes):
    return load_logs([path], {**mapping("ros2"), "frame": {}, **changes})[0]


@pytest.mark.parametrize("storage", ["sqlite3", "mcap"])
def test_a_bag_is_read_from_its_folder_file_or_zip(tmp_path, storage):
    file = write_bag(tmp_path / "bag", 300, storage)
    with zipfile.ZipFile(tmp_path / "bag.zip", "w") as archive:
        for path in file.parent.iterdir():
            archive.write(path, f"drive/{path.name}")
    for path in (file.parent, file, tmp_path / "bag.zip"):
        log = load(path)
        assert log.dt == 0.01 and len(log.table) == 300
        np.testing.assert_allclose(log.array("v_x"), 1.0, atol=1e-3)
        np.testing.assert_allclose(log.array("yaw_rate"), 0.5, atol=1e-5)
        np.testing.assert_allclose(log.array("omega"), 1.0, atol=1e-9)
        np.testing.assert_allclose(log.array("delta_ref"), 0.2, atol=1e-6)
        np.testing.assert_allclose(log.array("omega_ref"), 1.0, atol=1e-6)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bag", "bag.zip"]


def test_ackermann_commands_and_the_received_stamp(tmp_path):
    file = write_bag(tmp_path / "bag", 100)
    channels = {
        "x": {"topic": "/pose", "field": "pose.position.x"},
        "delta_ref": {"topic": "/drive", "field": "drive.steering_angle"},
    }
    log = load(file, channels=channels, time={"stamp": "received"})
    assert log.channels == ["x", "delta_ref"] and log.array("delta_ref")[0] == pytest.approx(0.2)


@pytest.mark.parametrize(
    "channels, said",
    [
        ({"x": {"topic": "/psoe", "field": "pose.position.x"}}, "did you mean /pose"),
        ({"x": {"topic": "/pose", "field": "pose.positon.x"}}, "did you mean position"),
        ({"x": {"topic": "/pose", "field": "pose"}}, "no number"),
        ({"x": {"topic": "/pose", "field": "pose.__class__.x"}}, "no field"),
    ],
)
def test_a_wrong_topic_map_is_one_line(tmp_path, channels, said):
    with pytest.raises(LogError, match=said) as error:
        load(write_bag(tmp_path / "bag"), channels=channels)
    assert "\n" not in str(error.value)


def test_a_few_impossible_messages_are_left_out_many_are_an_error(tmp_path):
    def few(i, pose, state):
        pose["norm"] = 7.0 if i == 50 else 1.0
        state["t"] += 1e8 if i == 70 else 0.0

    log = load(write_bag(tmp_path / "few", 300, change=few))
    assert sum("impossible" in remark for remark in log.remarks) == 2
    np.testing.assert_allclose(log.array("v_x"), 1.0, atol=1e-2)

    def many(i, pose, state):
        pose["norm"] = 7.0 if i % 5 == 0 else 1.0

    with pytest.raises(LogError, match="impossible"):
        load(write_bag(tmp_path / "many", 300, change=many))


def test_a_wildly_scaled_bag_is_refused(tmp_path):
    def far(i, pose, state):
        pose["x"] *= 1000.0
        pose["y"] *= 1000.0

    with pytest.raises(LogError, match="unit"):
        load(write_bag(tmp_path / "bag", 300, change=far))


@pytest.mark.parametrize("storage", ["sqlite3", "mcap"])
def test_a_bag_cut_short_is_one_line(tmp_path, storage):
    file = write_bag(tmp_path / "bag", 100, storage)
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    with pytest.raises(LogError, match=r"damaged|cut short|cannot be") as error:
        load(file)
    assert "\n" not in str(error.value)


def test_a_bag_is_damaged_where_a_record_is(tmp_path):
    file = write_bag(tmp_path / "bag", 100, "mcap")
    content = file.read_bytes()
    second = 8 + 9 + int.from_bytes(content[9:17], "little")  # magic, opcode and length of the first record
    for begin, damaged in (
        (0, b"x" + content[1:]),
        (second, content[: second + 1] + b"\xff" * 8 + content[second + 9 :]),
    ):
        file.write_bytes(damaged)
        with pytest.raises(LogError, match=f"damaged at byte {begin};"):
            load(file)


def test_empty_and_foreign_places(tmp_path):
    (tmp_path / "empty").mkdir()
    with pytest.raises(LogError, match=r"0 \.db3 or \.mcap"):
        load(tmp_path / "empty")
    (tmp_path / "empty" / "log.parquet").touch()
    with pytest.raises(LogError, match=r"give the log in it, as .*empty/log\.parquet"):
        load(tmp_path / "empty")
    sqlite3.connect(tmp_path / "other.db3").execute("create table a (b)").connection.commit()
    with pytest.raises(LogError, match="damaged"):
        load(tmp_path / "other.db3")
    (tmp_path / "a.zip").write_bytes(b"PK nonsense")
    with pytest.raises(LogError, match="zip"):
        load(tmp_path / "a.zip")


def test_compressed_bags_say_how_to_convert_them(tmp_path):
    file = write_bag(tmp_path / "bag")
    text = (file.parent / "metadata.yaml").read_text()
    (file.parent / "metadata.yaml").write_text(text.replace("compression_mode: ''", "compression_mode: FILE"))
    if "FILE" not in (file.parent / "metadata.yaml").read_text():
        pytest.fail("the metadata has another layout")
    with pytest.raises(LogError, match="convert it first"):
        load(file.parent)


def test_a_zip_that_grows_beyond_all_measure_is_not_unpacked(tmp_path):
    path = tmp_path / "bomb.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a.db3", bytes(60_000_000))
    with pytest.raises(LogError, match=f"more than {max(SMALL, MAX_RATIO * path.stat().st_size)} bytes when unpacked"):
        load(path)


def test_a_zip_bomb_and_a_climbing_name_are_harmless(tmp_path, monkeypatch):
    monkeypatch.setattr("racerl.data.bag.MAX_UNPACKED", 1_000_000)
    with zipfile.ZipFile(tmp_path / "bomb.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a.db3", bytes(50_000_000))
    with pytest.raises(LogError, match="when unpacked"):
        load(tmp_path / "bomb.zip")
    with zipfile.ZipFile(tmp_path / "climb.zip", "w") as archive:
        archive.writestr("../../climbed.db3", b"nothing")
    with pytest.raises(LogError):
        load(tmp_path / "climb.zip")
    assert not list(tmp_path.parent.parent.glob("climbed.db3"))


def test_a_chunk_that_lies_about_its_size_is_refused(tmp_path):
    from backports import zstd

    file = write_bag(tmp_path / "bag", 50, "mcap")
    content = file.read_bytes()
    records = zstd.compress(bytes(300_000_000))
    chunk = bytes(16) + (1000).to_bytes(8, "little") + bytes(4) + b"\x04\0\0\0zstd" + len(records).to_bytes(8, "little")
    begin = 8 + 9 + int.from_bytes(content[9:17], "little")
    bomb = b"\x06" + (len(chunk) + len(records)).to_bytes(8, "little") + chunk + records
    file.write_bytes(content[:begin] + bomb + content[begin:])
    began = time.monotonic()
    with pytest.raises(LogError, match="damaged"):
        load(file)
    assert time.monotonic() - began < 1.0


def test_the_measured_bag(tmp_path):
    path = measured("put/tyre_a_rosbag2.zip")
    log = load_logs([path], mapping("ros2"))[0]
    assert log.seconds == pytest.approx(55.5, abs=0.1) and log.dt == 0.01
    assert {"x", "y", "yaw", "v_x", "v_y", "yaw_rate", "omega", "current", "delta_ref"} == set(log.channels)
    v_x, omega = log.array("v_x"), log.array("omega")
    assert np.median(omega[v_x > 0.6] / v_x[v_x > 0.6]) == pytest.approx(1.0, abs=0.06)
    straight = (v_x > 0.6) & (np.abs(log.array("yaw_rate")) < 0.2)
    assert abs(np.median(log.array("v_y")[straight] / v_x[straight])) < 0.02
    shutil.copy(path, tmp_path / "copy.zip")
    (tmp_path / "copy.zip").write_bytes(path.read_bytes()[:1_000_000])
    with pytest.raises(LogError, match="zip"):
        load_logs([tmp_path / "copy.zip"], mapping("ros2"))


def test_the_parts_of_a_bag_are_read_in_the_order_they_were_recorded(tmp_path):
    bag, whole = tmp_path / "bag", load(write_bag(tmp_path / "whole", 240))
    bag.mkdir()
    for part in range(12):
        file = write_bag(tmp_path / f"part_{part}", 20, first=20 * part)
        shutil.copy(file, bag / f"drive_{part}.db3")
    split = load(bag)
    np.testing.assert_allclose(split.table[["x", "yaw", "omega"]], whole.table[["x", "yaw", "omega"]], atol=1e-9)


@pytest.mark.parametrize("off", [-0.5, -0.2, 0.2, 0.5])
def test_one_wrong_stamp_costs_one_message(tmp_path, off):
    def spoil(i, pose, state):
        pose["t"] += off if i == 200 else 0.0

    log = load(write_bag(tmp_path / "bag", 400, change=spoil))
    assert any(line.startswith("1 of 400 messages on /pose left out") for line in log.remarks)
    np.testing.assert_allclose(log.array("v_x"), 1.0, atol=1e-3)


def test_a_command_that_pauses_is_told_of(tmp_path):
    file = write_bag(tmp_path / "bag", 600)
    with sqlite3.connect(file) as database:
        topic = database.execute("SELECT id FROM topics WHERE name = '/drive'").fetchone()[0]
        rows = database.execute("SELECT id FROM messages WHERE topic_id = ? ORDER BY timestamp", (topic,)).fetchall()
        database.executemany("DELETE FROM messages WHERE id = ?", rows[100:400])
    assert "omega_ref pauses (3.0 s); its last value is taken to hold" in load(file).remarks
