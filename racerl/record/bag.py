"""A drive log as a ROS 2 bag (MCAP) with the topics of the stock F1TENTH system, as `data=f1tenth` reads them.

    /pose                            PoseStamped            x, y, yaw: a motion capture of the centre of gravity
    /sensors/core                    VescStateStamped       omega in electrical rpm; the motor's current, else NaN
    /sensors/servo_position_command  Float64                delta_ref in the servo's unit
    /ackermann_cmd                   AckermannDriveStamped  delta_ref and omega_ref, in single precision
    /odom                            Odometry               what the system makes of wheel and servo: no measurement

Velocities are left to the reader, which makes the same of the poses. A measured steering angle has no stock topic and
is left out, as it is on a stock car. The servo is not limited to 0.15 … 0.85, for the simulated one is not. A car that
takes currents has no /ackermann_cmd. Runs are parted by a pause on the clock, which is how the reader tells them.
"""

import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from racerl.data.messages import ACKERMANN, NUMBER, ODOMETRY, POSE_STAMPED, VESC_STATE, typestore

# f1tenth/f1tenth_system, f1tenth_stack/config/vesc.yaml, and the inverse in conf/data/f1tenth.yaml
ERPM_GAIN = 4614.0  # per m/s
SERVO_GAIN, SERVO_OFFSET = -1.2135, 0.5304  # per rad, at rest
START = 1_000_000_000  # s, of the clock
PAUSE = 1.0  # s between runs

Array = NDArray[np.float64]


def encode_bag(log: pd.DataFrame, wheelbase: float) -> bytes:
    """Return a log (`racerl.record.record.table`) as an MCAP file; the same log gives the same bytes."""
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

    store = typestore()
    with tempfile.TemporaryDirectory(prefix="racerl-bag-") as folder:
        writer = Writer(Path(folder) / "bag", version=9, storage_plugin=StoragePlugin.MCAP)
        writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        with writer:
            connections: dict[str, Any] = {}
            for topic, kind, stamp, message in messages(log, wheelbase, store.types):
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, kind, typestore=store)
                writer.write(connections[topic], stamp, store.serialize_cdr(message, kind))
        return next((Path(folder) / "bag").glob("*.mcap")).read_bytes()


def messages(log: pd.DataFrame, wheelbase: float, types: Any) -> Iterator[tuple[str, str, int, Any]]:
    """Yield (topic, type, stamp in ns, message) in the order of time."""
    pauses = PAUSE * log["run"].diff().ne(0).cumsum().sub(1)
    stamps = START * 1_000_000_000 + np.round((log["t"] + pauses).to_numpy() * 1e6).astype(np.int64) * 1000
    blank = np.full(len(log), np.nan)
    erpm, current = ERPM_GAIN * log["omega"].to_numpy(), log["current"].to_numpy() if "current" in log else blank
    servo = SERVO_OFFSET + SERVO_GAIN * log["delta_ref"].to_numpy()
    speed = log["omega_ref"].to_numpy() if "omega_ref" in log else blank
    reckoned = zip(*_reckon(log, wheelbase), strict=True)
    columns = (log["x"], log["y"], log["yaw"], erpm, current, servo, log["delta_ref"], speed, reckoned)
    make = _Maker(types)
    for stamp, *row in zip(stamps.tolist(), *columns, strict=True):
        x, y, yaw, rpm, ampere, position, delta_ref, omega_ref, odometry = row
        header = make.header(stamp)
        yield "/pose", POSE_STAMPED, stamp, types[POSE_STAMPED](header=header, pose=make.pose(x, y, yaw))
        yield "/sensors/core", VESC_STATE, stamp, make.state(header, rpm, ampere)
        yield "/sensors/servo_position_command", NUMBER, stamp, types[NUMBER](data=float(position))
        if not np.isnan(omega_ref):
            yield "/ackermann_cmd", ACKERMANN, stamp, make.command(header, delta_ref, omega_ref)
        yield "/odom", ODOMETRY, stamp, make.odometry(header, *odometry)


def _reckon(log: pd.DataFrame, wheelbase: float) -> tuple[Array, ...]:
    """Return x, y, yaw, v_x, yaw_rate of the rear axle as the stock node reckons them, from where the log begins."""
    speed = log["omega"].to_numpy()
    turning = speed * np.tan(log["delta_ref"].to_numpy()) / wheelbase
    dt = np.diff(log["t"].to_numpy(), prepend=log["t"].iloc[0])
    yaw = np.cumsum(turning * dt)
    before = np.concatenate([[0.0], yaw[:-1]])
    return np.cumsum(speed * np.cos(before) * dt), np.cumsum(speed * np.sin(before) * dt), yaw, speed, turning


class _Maker:
    """Builds messages from numbers."""

    def __init__(self, types: Any) -> None:
        self.types = types
        self.zero = types["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=0.0)
        self.unknown = np.zeros(36)

    def header(self, stamp: int) -> Any:
        time = self.types["builtin_interfaces/msg/Time"](sec=stamp // 1_000_000_000, nanosec=stamp % 1_000_000_000)
        return self.types["std_msgs/msg/Header"](stamp=time, frame_id="map")

    def pose(self, x: float, y: float, yaw: float) -> Any:
        point = self.types["geometry_msgs/msg/Point"](x=float(x), y=float(y), z=0.0)
        turned = self.types["geometry_msgs/msg/Quaternion"](
            x=0.0, y=0.0, z=float(np.sin(yaw / 2)), w=float(np.cos(yaw / 2))
        )
        return self.types["geometry_msgs/msg/Pose"](position=point, orientation=turned)

    def state(self, header: Any, erpm: float, current: float) -> Any:
        kind = self.types["vesc_msgs/msg/VescState"]
        rest = {name: 0 for name in kind.__dataclass_fields__ if not name.startswith("_")}
        state = kind(**{**rest, "speed": float(erpm), "current_motor": float(current)})
        return self.types[VESC_STATE](header=header, state=state)

    def command(self, header: Any, delta_ref: float, omega_ref: float) -> Any:
        drive = self.types["ackermann_msgs/msg/AckermannDrive"](
            steering_angle=float(delta_ref),
            steering_angle_velocity=0.0,
            speed=float(omega_ref),
            acceleration=0.0,
            jerk=0.0,
        )
        return self.types[ACKERMANN](header=header, drive=drive)

    def odometry(self, header: Any, x: float, y: float, yaw: float, v_x: float, yaw_rate: float) -> Any:
        vector, covariance = self.types["geometry_msgs/msg/Vector3"], {"covariance": self.unknown}
        twist = self.types["geometry_msgs/msg/Twist"](
            linear=vector(x=float(v_x), y=0.0, z=0.0), angular=vector(x=0.0, y=0.0, z=float(yaw_rate))
        )
        pose = self.types["geometry_msgs/msg/PoseWithCovariance"](pose=self.pose(x, y, yaw), **covariance)
        moving = self.types["geometry_msgs/msg/TwistWithCovariance"](twist=twist, **covariance)
        return self.types[ODOMETRY](header=header, child_frame_id="base_link", pose=pose, twist=moving)
