"""Bags of systems that others built: read by the mapping that fits, told from reckoning, or a draft to start from."""

import numpy as np
import pytest

from racerl import cli
from racerl.config import compose_settings
from racerl.data.inspect import inspect
from racerl.data.layout import read_layout
from racerl.data.load import load_logs, load_measured
from racerl.data.messages import ODOMETRY, POSE_STAMPED
from racerl.data.topics import Topic, UnmappedBag, draft, found
from racerl.documents import read_yaml
from racerl.errors import LogError
from tests.data.conftest import mapping, write_topics

STOCK = ("/odom", "/sensors/core", "/sensors/servo_position_command")
PLAIN = {topic: topic for topic in STOCK} | {"/ackermann_cmd": "/drive"}
SYSTEMS = {
    "f1tenth": (PLAIN | {"/pose": "/pf/viz/inferred_pose"}, {"delta_ref", "omega_ref", "omega"}),
    "race_stack": (
        {
            "/pose": "/car_state/pose",
            "/odom": "/vesc/odom",
            "/sensors/core": "/vesc/sensors/core",
            "/sensors/servo_position_command": "/vesc/sensors/servo_position_command",
            "/ackermann_cmd": "/vesc/high_level/ackermann_cmd_mux/input/nav_1",
        },
        {"delta_ref", "omega_ref", "omega"},
    ),
    "f1tenth_gym": ({"/odom": "/ego_racecar/odom", "/ackermann_cmd": "/drive"}, {"delta_ref", "omega_ref"}),
}


@pytest.fixture(scope="module")
def short(driven):
    """Six seconds of one run."""
    return driven.iloc[:600].reset_index(drop=True)


def load(path, name="drive_log", **changes):
    return load_logs([path], {**mapping(name), **changes})[0]


def true_odometry(log):
    """Return what puts a log's own poses into the messages on /odom."""
    rows = iter(log[["x", "y", "yaw"]].to_numpy().tolist())

    def spoil(topic, message):
        if topic == "/odom":
            x, y, yaw = next(rows)
            message.pose.pose.position.x, message.pose.pose.position.y = x, y
            message.pose.pose.orientation.z, message.pose.pose.orientation.w = np.sin(yaw / 2), np.cos(yaw / 2)

    return spoil


@pytest.mark.parametrize("system", SYSTEMS)
def test_a_stock_bag_is_read_by_the_mapping_that_fits_without_being_told(short, tmp_path, system):
    names, others = SYSTEMS[system]
    spoil = true_odometry(short) if system == "f1tenth_gym" else None
    bag = write_topics(tmp_path / "bag", short, names, spoil)
    log = load(bag)
    assert f"read by data={system}" in log.remarks[0]
    assert set(log.channels) == {"x", "y", "yaw", "v_x", "v_y", "yaw_rate", *others}
    assert load(bag, system).table.equals(log.table)
    told = load(bag, system, frame={})
    np.testing.assert_allclose(told.array("x"), short["x"], atol=1e-9)
    np.testing.assert_allclose(told.array("omega_ref"), short["omega_ref"], atol=1e-6)
    if system == "f1tenth":
        np.testing.assert_allclose(told.array("delta_ref"), short["delta_ref"], atol=1e-6)
        np.testing.assert_allclose(told.array("omega"), short["omega"], atol=1e-5)


def test_an_odometry_that_is_reckoned_is_read_warned_of_and_never_fitted(short, tmp_path):
    bag = write_topics(tmp_path / "bag", short, PLAIN)
    log = load(bag)
    warnings = [line for line in inspect(log)["warnings"] if "reckoned" in line]
    assert log.reckoned and len(warnings) == 1 and "no slip" in warnings[0] and "record a measured" in warnings[0]
    with pytest.raises(LogError, match="reckoned from wheel") as error:
        load_measured({"logs": [str(bag)], "data": mapping("f1tenth")})
    assert "\n" not in str(error.value)
    assert not load(write_topics(tmp_path / "true", short, PLAIN, true_odometry(short))).reckoned
    assert not load(write_topics(tmp_path / "pose", short, {**PLAIN, "/pose": "/pose"})).reckoned


def test_a_mapping_that_finds_no_pose_is_an_error_that_names_the_one_that_fits(short, tmp_path):
    bag = write_topics(tmp_path / "bag", short, PLAIN)
    for name in ("ros2", "f1tenth_gym"):
        with pytest.raises(LogError, match="no pose and no velocity; data=f1tenth fits its topics"):
            load(bag, name)
    with pytest.raises(LogError, match="names no topics; give data=f1tenth"):
        load(bag, gap=0.2)  # what was set by hand is not thrown away


def test_a_strange_bag_is_listed_with_a_mapping_that_reads_it(short, tmp_path, capsys):
    strange = dict(
        zip(
            ("/pose", *STOCK[1:], "/ackermann_cmd", "/odom"),
            ("/vicon/car", "/esc", "/servo", "/cmd", "/wheel_odom"),
            strict=True,
        )
    )
    bag = write_topics(tmp_path / "bag", short, strange)
    settings = {**compose_settings("data", ["logs=[x]"]), "logs": [str(bag)]}
    with pytest.raises(UnmappedBag, match="data=mine") as error:
        cli._data([], settings, tmp_path / "run")
    assert "\n" not in str(error.value) and not (tmp_path / "run").exists()
    printed = capsys.readouterr().out
    with pytest.raises(UnmappedBag, match="data=mine"):
        load(bag, "f1tenth")  # its /odom is no misspelt topic of this bag
    assert "/vicon/car" in printed and "std_msgs/msg/Float64" in printed and "600" in printed
    (tmp_path / "mine.yaml").write_text(printed[printed.index("# conf/data/mine.yaml") :])
    mine = read_yaml(tmp_path / "mine.yaml")
    assert len((tmp_path / "mine.yaml").read_text().split("channels:")[1].strip().splitlines()) == 7
    log = load_logs([bag], mine)[0]
    np.testing.assert_allclose(log.array("delta_ref"), short["delta_ref"], atol=1e-4)
    np.testing.assert_allclose(log.array("omega"), short["omega"], rtol=1e-3, atol=1e-3)
    np.testing.assert_allclose(log.array("yaw_rate")[20:-20], short["yaw_rate"][20:-20], atol=0.5)
    assert log.dt == 0.01 and not any("untestable" in line and "current" not in line for line in log.remarks)


def test_a_bag_without_a_pose_says_to_record_one(short, tmp_path):
    bag = write_topics(tmp_path / "bag", short, {"/sensors/core": "/esc"})
    with pytest.raises(UnmappedBag, match="record a pose") as error:
        load(bag)
    assert error.value.topics == (Topic("/esc", "vesc_msgs/msg/VescStateStamped", 600),)


def test_a_draft_quotes_what_yaml_would_read_otherwise(tmp_path):
    text = draft(tmp_path, [Topic("/a: {b", "geometry_msgs/msg/PoseStamped", 3)])
    (tmp_path / "a.yaml").write_text(text)
    assert read_layout(read_yaml(tmp_path / "a.yaml")).channels["x"][0].topic == "/a: {b"


def test_commands_without_a_stamp_take_the_time_they_came(short, tmp_path):
    def spoil(topic, message):
        if topic == "/ackermann_cmd":
            message.header.stamp.sec = message.header.stamp.nanosec = 0

    names = PLAIN | {"/pose": "/pose"}
    log = load(write_topics(tmp_path / "bag", short, names, spoil))
    np.testing.assert_allclose(log.array("omega_ref"), short["omega_ref"], atol=1e-6)


def test_a_field_that_nobody_filled_costs_no_other(short, tmp_path):
    log = load(write_topics(tmp_path / "bag", short, PLAIN | {"/pose": "/pose"}))
    assert "current on /sensors/core is no number in any message: untestable" in log.remarks
    assert "current" not in log.channels and "omega" in log.channels


def test_a_pose_that_comes_too_seldom_is_said(short, tmp_path):
    rows = short.iloc[::5]
    log = load(write_topics(tmp_path / "bag", rows, PLAIN | {"/pose": "/pose"}))
    assert any("20 times per second, too seldom" in line for line in log.remarks)


def test_a_topic_gives_the_channel_from_where_its_type_has_it(short, tmp_path):
    """Two types have been published on one name by two systems: slam_toolbox's /pose carries a covariance."""
    bag = write_topics(tmp_path / "bag", short, PLAIN, true_odometry(short))
    channels = {"x": {"topic": "/odom", "field": "pose.position.x"}, "y": ["/nothing", "/odom"], "yaw": "/odom"}
    channels["x"] = [channels["x"], "/odom"]  # the first is another type's
    log = load(bag, channels=channels)
    np.testing.assert_allclose(log.array("x"), short["x"], atol=1e-9)


def test_a_topic_without_messages_gives_way_to_one_with_them():
    pose, filtered = (
        Topic(name, kind, count)
        for name, kind, count in (("/pose", POSE_STAMPED, 0), ("/pf/pose/odom", ODOMETRY, 2400))
    )
    layout = read_layout(mapping("f1tenth"))
    assert found(layout, [pose, filtered])["x"].topic == "/pf/pose/odom"
    assert found(layout, [pose])["x"].topic == "/pose"
