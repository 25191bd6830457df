"""What a policy sees, one file each; module `geometric` holds the class `Geometric`."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Protocol

import torch
from torch import Tensor

from racerl import registry

if TYPE_CHECKING:
    from racerl.env.race import Race

SPEED_MAX = 6.0  # m/s
YAW_RATE_MAX = 4.0  # rad/s
HEADING_MAX = torch.pi  # rad
OBSERVATION_LIMIT = 10.0  # of any normalised number; only a car that tumbles comes near


class Observation(Protocol):
    """Turns the race into one row of numbers per car, each divided by its maximum."""

    @property
    def size(self) -> int:
        """Numbers per car."""

    def __call__(self, race: "Race") -> Tensor:
        """Return the observation (N, size)."""


def create_observation(settings: Mapping[str, Any]) -> Observation:
    """Build the observation that `settings["name"]` names."""
    import racerl.env.observations as package

    return registry.create(package, settings)


def actuator_terms(race: "Race") -> list[Tensor]:
    """Return δ, δ_ref, the rate of the drive command, the drive command and ω, each (N,)."""
    return [
        race.delta / race.action.steering_max,
        race.command[0] / race.action.steering_max,
        race.command_rate / race.action.rate_max,
        race.command[1] / race.action.drive_max,
        race.omega / SPEED_MAX,
    ]
