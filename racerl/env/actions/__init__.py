"""How a policy's output in [−1, 1]² becomes a command, one file each; module `speed_rate` holds `SpeedRate`.

A command is (2, N): the steering reference in rad and the drive reference, a wheel speed in m/s or a current in A.
"""

from collections.abc import Mapping
from typing import Any, ClassVar, Protocol

from torch import Tensor

from racerl import bounds, registry

OMEGA_REF_MIN, OMEGA_REF_MAX = 0.01, 7.0  # m/s


class Action(Protocol):
    """A map from policy outputs to commands."""

    drive_mode: ClassVar[str]  # the vehicle's drive mode that the command is for
    integrated: ClassVar[bool]  # whether the drive reference is limited to a rate, rate_max
    steering_max: float  # rad
    drive_max: float  # m/s or A
    rate_max: float  # m/s² or A/s

    def __hash__(self) -> int:
        """Actions don't change."""

    @property
    def drive_min(self) -> float:
        """Least drive reference in m/s or A."""

    def command(self, action: Tensor, last: Tensor, dt: float) -> Tensor:
        """Return the command (2, N) for outputs (N, 2) in [−1, 1], given the last command (2, N)."""

    def initial(self, omega: Tensor) -> Tensor:
        """Return the drive reference (N,) of cars that start with wheel speed ω (N,)."""


def check_limits(steering_max: float, drive_max: float, rate_max: float) -> None:
    """Raise ConfigError for limits that no car could have."""
    bounds.number("action.steering_max", steering_max, 0.01, 1.5, "rad")
    bounds.number("action.drive_max", drive_max, 0.1, 1000.0, "m/s or A")
    bounds.number("action.rate_max", rate_max, 0.01, 1e5, "of the drive reference per s")


def middle(action: Action) -> float:
    """Return the middle of the drive reference's range."""
    return (action.drive_max + action.drive_min) / 2


def half_range(action: Action) -> float:
    """Return half of the drive reference's range."""
    return (action.drive_max - action.drive_min) / 2


def outputs(action: Action, steering: Any, drive: Any, last: Any, dt: float) -> tuple[Any, Any]:
    """Return the outputs that command a steering and a drive reference after the last drive reference.

    Numbers or tensors (N,); references that are out of reach lie beyond ± 1.
    """
    reach = (
        (drive - last) / (action.rate_max * dt) if action.integrated else (drive - middle(action)) / half_range(action)
    )
    return steering / action.steering_max, reach


def create_action(settings: Mapping[str, Any]) -> Action:
    """Build the action that `settings["name"]` names."""
    import racerl.env.actions as package

    return registry.create(package, settings)
