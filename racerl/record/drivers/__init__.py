"""What drives the car for a log, one file each; module `human_like` holds `HumanLike`.

A driver sees what a real car's driver would: noisy measurements, and the configured vehicle, which need not be the one
it sits in. It is a coroutine: it yields a command, and receives the measurement at the end of that control step.
"""

from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np

from racerl import bounds, registry
from racerl.track.track import Track
from racerl.vehicle.vehicle import Vehicle


class Measured(NamedTuple):
    """A measurement: noisy pose and actuators, and velocities in the body frame estimated from past poses."""

    t: float  # s
    x: float  # m
    y: float  # m
    yaw: float  # rad, unwrapped
    v_x: float  # m/s
    v_y: float  # m/s
    yaw_rate: float  # rad/s
    delta: float  # rad
    omega: float  # m/s


class Command(NamedTuple):
    """What is held over a control step; `run` and `doing` go into the log beside it."""

    delta_ref: float  # rad
    omega_ref: float  # m/s
    run: int
    doing: str


class Pose(NamedTuple):
    """Place and heading in the world, in m and rad."""

    x: float
    y: float
    yaw: float


@dataclass(frozen=True)
class Scene:
    """What the driver knows before it starts."""

    vehicle: Vehicle  # as configured: a hidden car differs from it
    track: Track
    floor: tuple[float, float]  # m, sides along x and y; its middle is the origin
    dt: float  # s, control period
    seconds: float  # s, of the whole drive
    generator: np.random.Generator


Drive = Generator[Command, Measured, None]


class Driver(Protocol):
    """Drives one car."""

    def begin(self, scene: Scene) -> tuple[Pose, Callable[[Measured], Drive]]:
        """Return where the car stands at first, and what drives it from its first measurement on, without end."""


def create_driver(settings: Mapping[str, Any]) -> Driver:
    """Build the driver that `settings["name"]` names."""
    import racerl.record.drivers as package

    driver: Driver = registry.create(package, settings)
    return driver


def check_ranges(driver: object, **ranges: tuple[float, float]) -> None:
    """Raise ConfigError when one of a driver's settings is no number in its range."""
    for name, (low, high) in ranges.items():
        bounds.number(f"drive.{name}", getattr(driver, name), low, high)
