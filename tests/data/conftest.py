"""Logs to read: simulated ones that are clean, small bags, and the measured ones where they are at hand."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import casadi
import numpy as np
import pandas as pd
import pytest

from racerl.config import compose_settings
from racerl.documents import read_yaml
from racerl.vehicle.integrate import advance
from racerl.vehicle.load import load_vehicle
from racerl.vehicle.ops import CasadiOps
from tests.conftest import CONF

MEASURED = CONF.parent.parent / "shared" / "data"
NOISE = {"x": 1e-3, "y": 1e-3, "yaw": 2e-3, "v_x": 0.02, "v_y": 0.02, "yaw_rate": 0.03, "delta": 2e-3, "omega": 0.03}
HEADER = "std_msgs/msg/Header"


def measured(name: str) -> Path:
    """Return a measured log, or skip the test."""
    path = MEASURED / name
    if not path.is_file():
        pytest.skip(f"the measured log {name} is not beside the repository")
    return path


def mapping(name: str) -> dict[str, Any]:
    return read_yaml(CONF / "data" / f"{name}.yaml")


def simulate(overrides: tuple[str, ...] = (), seed: int = 0, top: float = 4.5, runs: int = 3) -> pd.DataFrame:
    """Return 20 s per run of a car that follows wandering references, with the noise of a good laboratory."""
    car = load_vehicle(compose_settings("train", ["vehicle=published", *overrides])["vehicle"])
    x, u = casadi.SX.sym("x", len(car.states)), casadi.SX.sym("u", 2)
    count = 2000
    drive = casadi.Function("f", [x, u], [advance(car, x, u, 0.01, 1, CasadiOps())]).mapaccum(count)
    dice = np.random.default_rng(seed)

    def wander(low: float, high: float, every: int) -> np.ndarray:
        knots = dice.uniform(low, high, count // every + 2)
        line = np.interp(np.arange(count), np.arange(len(knots)) * every, knots)
        return np.repeat(line[::5], 5)

    tables = []
    for run in range(runs):
        delta_ref, omega_ref = wander(-0.35, 0.35, 40), wander(1.2, top, 60)
        start = np.zeros(len(car.states))
        start[3] = start[7] = omega_ref[0]
        states = np.array(drive(start, np.stack([delta_ref, omega_ref]))).T
        rows = pd.DataFrame(np.vstack([start, states[:-1]])[:, :8], columns=list(NOISE))
        for name, size in NOISE.items():
            rows[name] += size * dice.standard_normal(count)
        t = 100.0 * run + 0.01 * np.arange(count)
        tables.append(rows.assign(delta_ref=delta_ref, omega_ref=omega_ref, t=t, run=run))
    return pd.concat(tables, ignore_index=True)


@pytest.fixture(scope="session")
def driven() -> pd.DataFrame:
    """A clean simulated log of 60 s; tests copy what they change."""
    return simulate()


@pytest.fixture(scope="session")
def small(driven: pd.DataFrame) -> pd.DataFrame:
    """40 rows of two runs."""
    return pd.concat([driven.iloc[:20], driven.iloc[2000:2020]], ignore_index=True)


def write_bag(
    folder: Path,
    count: int = 30,
    storage: str = "sqlite3",
    change: Callable[..., None] | None = None,
    first: int = 0,
) -> Path:
    """Write a bag of a car on a circle (radius 2 m, 1 m/s, wheel speed 1 m/s) and return its storage file.

    `change(i, pose, state)` may spoil the i-th messages; recording begins with the `first`.
    """
    from rosbags.rosbag2 import StoragePlugin, Writer

    from racerl.data.messages import typestore

    store = typestore()
    types = store.types
    plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3

    def header(t: float) -> Any:
        stamp = types["builtin_interfaces/msg/Time"](sec=int(t), nanosec=round((t % 1) * 1e9))
        return types[HEADER](stamp=stamp, frame_id="map")

    with Writer(folder, version=9, storage_plugin=plugin) as writer:
        kinds = {
            "/pose": "geometry_msgs/msg/PoseStamped",
            "/vesc/core": "vesc_msgs/msg/VescStateStamped",
            "/vesc/servo_position_command": "std_msgs/msg/Float64",
            "/drive": "ackermann_msgs/msg/AckermannDriveStamped",
        }
        connections = {topic: writer.add_connection(topic, kind, typestore=store) for topic, kind in kinds.items()}
        for i in range(first, first + count):
            t = 1_000_000_000.0 + 0.01 * i
            angle = 0.5 * 0.01 * i
            pose = {"x": 2 * np.sin(angle), "y": 2 - 2 * np.cos(angle), "yaw": angle, "t": t, "norm": 1.0}
            state = {"speed": 1.0 / 2.469e-4, "servo": 0.5 - 0.2 / 1.25, "t": t}
            if change:
                change(i, pose, state)
            half, norm = pose["yaw"] / 2, pose["norm"]
            turned = types["geometry_msgs/msg/Quaternion"](
                x=0.0, y=0.0, z=float(norm * np.sin(half)), w=float(norm * np.cos(half))
            )
            point = types["geometry_msgs/msg/Point"](x=float(pose["x"]), y=float(pose["y"]), z=0.0)
            vesc = types["vesc_msgs/msg/VescState"]
            zeros = {name: 0 for name in vesc.__dataclass_fields__ if not name.startswith("_")}
            drive = types["ackermann_msgs/msg/AckermannDrive"]
            commanded = {name: 0.0 for name in drive.__dataclass_fields__ if not name.startswith("_")}
            messages = {
                "/pose": types[kinds["/pose"]](
                    header=header(pose["t"]), pose=types["geometry_msgs/msg/Pose"](position=point, orientation=turned)
                ),
                "/vesc/core": types[kinds["/vesc/core"]](
                    header=header(state["t"]), state=vesc(**{**zeros, "speed": float(state["speed"])})
                ),
                "/vesc/servo_position_command": types["std_msgs/msg/Float64"](data=float(state["servo"])),
                "/drive": types[kinds["/drive"]](
                    header=header(t), drive=drive(**{**commanded, "steering_angle": 0.2, "speed": 1.0})
                ),
            }
            for topic, message in messages.items():
                raw = store.serialize_cdr(message, kinds[topic])
                writer.write(connections[topic], round(t * 1e9), raw)
    return next(path for path in folder.iterdir() if path.suffix in (".db3", ".mcap"))


Renamed = Mapping[str, str]


def write_topics(folder: Path, log: pd.DataFrame, names: Renamed, spoil: Callable[..., None] | None = None) -> Path:
    """Write the recorder's messages of a log under the names given for its topics, the others left out; return the bag.

    `spoil(topic, message)` may change a message.
    """
    from rosbags.rosbag2 import StoragePlugin, Writer

    from racerl.data.messages import typestore
    from racerl.record.bag import messages

    store = typestore()
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections: dict[str, Any] = {}
        for topic, kind, stamp, message in messages(log, 0.33, store.types):
            for old, new in names.items():
                if old != topic:
                    continue
                if spoil:
                    spoil(topic, message)
                if new not in connections:
                    connections[new] = writer.add_connection(new, kind, typestore=store)
                writer.write(connections[new], stamp, store.serialize_cdr(message, kind))
    return folder
