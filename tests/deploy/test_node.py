"""The ROS 2 node on a stub of rclpy, fed with bags that `racerl record` writes."""

import contextlib
import math
import signal
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
import yaml

from racerl.config import compose_settings
from racerl.data.messages import typestore
from racerl.deploy.pilot import Order
from racerl.deploy.ros2 import node
from racerl.deploy.ros2.motion import Velocities
from racerl.deploy.ros2.node import PARAMETERS, make_node
from racerl.interruption import Terminated
from racerl.record.record import record

TOPICS = ("/pose", "/sensors/core", "/odom")


class Clock:
    """A time that stands until it is set."""

    now = 0.0

    def __call__(self):
        return self.now


class Node:
    """What the node asks of rclpy's."""

    given = None  # parameters

    def __init__(self, name):
        self.name, self.heard, self.timers, self.published, self.logged = name, {}, [], [], []

    def declare_parameter(self, name, value):
        return SimpleNamespace(value=self.given.get(name, value))

    def create_subscription(self, kind, topic, callback, qos):
        self.heard[topic] = callback

    def create_publisher(self, kind, topic, depth):
        return SimpleNamespace(publish=lambda message: self.published.append((topic, message)))

    def create_timer(self, period, callback):
        self.timers.append((period, callback))

    def get_logger(self):
        return SimpleNamespace(warning=self.logged.append)

    def get_clock(self):
        return SimpleNamespace(now=lambda: SimpleNamespace(to_msg=lambda: "now"))


@pytest.fixture
def ros(monkeypatch):
    """Stand in for ROS 2's modules."""

    def stub(name, **content):
        module = ModuleType(name)
        vars(module).update(content)
        monkeypatch.setitem(sys.modules, name, module)

    def ackermann():
        return SimpleNamespace(header=SimpleNamespace(stamp=None), drive=SimpleNamespace(steering_angle=0.0, speed=0.0))

    monkeypatch.setattr(Node, "given", {})
    stub("rclpy")
    stub("rclpy.node", Node=Node)
    stub("rclpy.qos", qos_profile_sensor_data="sensors")
    kinds = {
        "ackermann_msgs": {"AckermannDriveStamped": ackermann},
        "geometry_msgs": {"PoseStamped": "PoseStamped"},
        "nav_msgs": {"Odometry": "Odometry"},
        "std_msgs": {"String": lambda data: SimpleNamespace(data=data)},
        "vesc_msgs": {"VescStateStamped": "VescStateStamped"},
    }
    for package, messages in kinds.items():
        stub(package)
        stub(f"{package}.msg", **messages)


@pytest.mark.parametrize("end", [KeyboardInterrupt, Terminated(signal.SIGTERM), RuntimeError("a broken sensor")])
def test_the_car_is_told_to_stand_however_it_ends(ros, monkeypatch, end):
    """While the context is still open: rclpy's own handlers would have closed it."""
    told = []

    def spin(node):
        raise end

    rclpy = sys.modules["rclpy"]
    rclpy.init = lambda signal_handler_options: told.append(signal_handler_options)
    rclpy.spin, rclpy.try_shutdown = spin, lambda: told.append("shut down")
    signals = ModuleType("rclpy.signals")
    signals.SignalHandlerOptions = SimpleNamespace(NO="no handlers")
    monkeypatch.setitem(sys.modules, "rclpy.signals", signals)
    pilot = SimpleNamespace(
        drive=SimpleNamespace(publish=told.append),
        _message=lambda order: order,
        get_logger=lambda: SimpleNamespace(warning=lambda line: None),
        destroy_node=lambda: None,
    )
    monkeypatch.setattr(node, "make_node", lambda: pilot)
    monkeypatch.setattr(node, "listen", lambda: told.append("listens"))
    with contextlib.suppress(RuntimeError):
        node.main()
    assert told == ["no handlers", "listens", Order(0.0, 0.0, "ended"), "shut down"]


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    """Return the messages of a lap, (seconds, topic, message), in their order."""
    from rosbags.rosbag2 import Reader

    out = tmp_path_factory.mktemp("bags") / "lap"
    words = ["seconds=12", "drive=race", "vehicle=published", "file=log.mcap"]
    record(compose_settings("record", words), out)
    folder = out / "log.mcap"
    with Reader(folder) as reader:
        found = [
            (stamp * 1e-9, connection.topic, typestore().deserialize_cdr(raw, connection.msgtype))
            for connection, stamp, raw in reader.messages()
            if connection.topic in TOPICS
        ]
    begin = found[0][0]
    return [(time - begin, topic, message) for time, topic, message in found]


def play(node, clock, messages, period=0.05):
    """Hand a node the messages at their times, and let its timer tick between them."""
    tick = next(callback for each, callback in node.timers if each == pytest.approx(period))
    due = period
    for time, topic, message in messages:
        while due <= time:
            clock.now = due
            tick()
            due += period
        clock.now = time
        if topic in node.heard:
            node.heard[topic](message)
    return tick


@pytest.mark.parametrize("odometry", [False, True])
def test_it_drives_along_a_recorded_lap_and_stands_when_the_bag_ends(ros, bag, smoke_run, odometry):
    given = {"run": str(smoke_run), "most_speed": 1.5, "odometry": odometry, "guard.off_track": 100.0}
    Node.given = given | ({"pose_topic": "/odom", "forward": 0.0} if odometry else {})
    clock = Clock()
    pilot = make_node(clock=clock)
    assert set(pilot.heard) == {"/odom" if odometry else "/pose", "/sensors/core"}
    tick = play(pilot, clock, bag)
    orders = [message.drive for topic, message in pilot.published if topic == "/drive"]
    assert len(orders) == pytest.approx(bag[-1][0] / 0.05, abs=1)
    driven = [order for order in orders if order.speed > 0.0]
    assert len(driven) > 0.9 * len(orders)  # after half a second
    assert all(math.isfinite(order.steering_angle) and abs(order.steering_angle) <= 0.5 for order in orders)
    assert max(order.speed for order in orders) == pytest.approx(1.5)
    for late in (0.05, 0.1, 0.15, 0.2, 0.25):  # silence
        clock.now = bag[-1][0] + late
        tick()
    assert pilot.published[-1][1].drive.speed == 0.0 and "s old" in pilot.logged[-1]
    assert pilot.published[-4][1].drive.speed > 0.0
    beat = next(callback for period, callback in pilot.timers if period == 1.0)
    beat()
    assert pilot.published[-1][0] == "~/heartbeat" and "s old" in pilot.published[-1][1].data


def test_before_the_wheel_is_heard_it_stands(ros, bag, smoke_run):
    Node.given = {"run": str(smoke_run)}
    clock = Clock()
    pilot = make_node(clock=clock)
    play(pilot, clock, [each for each in bag[:600] if each[1] == "/pose"])
    assert {message.drive.speed for _, message in pilot.published} == {0.0} and "no finite omega" in pilot.logged[-1]
    assert len(pilot.logged) <= 3  # velocities take some poses


def test_a_wheel_that_falls_silent_stops_it(ros, bag, smoke_run):
    Node.given = {"run": str(smoke_run), "guard.off_track": 100.0, "latency": 0.01}
    clock = Clock()
    pilot = make_node(clock=clock)
    play(pilot, clock, [each for each in bag if each[0] < 3.0 and (each[0] < 2.0 or each[1] == "/pose")])
    speeds = [message.drive.speed for _, message in pilot.published]
    assert min(speeds[12:40]) > 0.0 and set(speeds[46:]) == {0.0} and "no finite omega" in pilot.logged[-1]


def test_velocities_are_those_of_the_poses(bag):
    rng, found = np.random.default_rng(0), Velocities()
    for time in np.arange(0.0, 3.0, 0.01):  # a circle of 2 m at 1.5 rad/s, tracked to half a millimetre
        angle = 1.5 * time
        x, y = 2.0 * math.sin(angle), 2.0 - 2.0 * math.cos(angle)
        noise = rng.normal(0.0, 1e-4, 3)
        told = found.add(time, x + noise[0], y + noise[1], math.remainder(angle + noise[2], 2 * math.pi))
        assert math.isnan(told[0]) == (time < 0.035)
        if time > 0.1:
            assert told == pytest.approx((3.0, 0.0, 1.5), abs=0.03)
    assert math.isnan(found.add(9.0, 0.0, 0.0, 0.0)[0])  # after a pause it begins anew


def test_the_parameters_of_the_file_are_the_nodes():
    content = yaml.safe_load((Path(node.__file__).with_name("pilot.yaml")).read_text())
    flat = {}
    for key, value in content["/racerl_pilot"]["ros__parameters"].items():
        flat |= {f"{key}.{inner}": each for inner, each in value.items()} if isinstance(value, dict) else {key: value}
    assert set(flat) == set(PARAMETERS)
    assert all(type(flat[name]) is type(PARAMETERS[name]) for name in flat)
