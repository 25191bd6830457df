"""What a policy sees, one file each; module `geometric` holds the class `Geometric`."""

from collections.abc import Mapping
from dataclasses import asdict
from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, cast

import torch
from torch import Tensor

from racerl import registry
from racerl.env.actions import Action
from racerl.track.track import Track

if TYPE_CHECKING:
    from racerl.env.race import View

SPEED_MAX = 6.0  # m/s
YAW_RATE_MAX = 4.0  # rad/s
HEADING_MAX = torch.pi  # rad
OBSERVATION_LIMIT = 10.0  # of any normalised number; only a car that tumbles comes near


class Seen(NamedTuple):
    """One number of an observation: what it is, and what it is divided by, in its unit."""

    name: str
    unit: str
    maximum: float


V_X, V_Y = Seen("v_x", "m/s", SPEED_MAX), Seen("v_y", "m/s", SPEED_MAX)
YAW_RATE = Seen("yaw_rate", "rad/s", YAW_RATE_MAX)
HEADING = Seen("u", "rad", HEADING_MAX)  # relative to the track


class Observation(Protocol):
    """Turns the race into one row of numbers per car, in units of their own; `scaled` divides them by their maxima."""

    def __hash__(self) -> int:
        """Observations don't change."""

    @property
    def size(self) -> int:
        """Numbers per car."""

    @property
    def memory(self) -> int:
        """Control steps that it looks back, for which races keep what `racerl.env.memory` has."""

    def fitted(self, *tracks: Track) -> "Observation":
        """Return the observation with its maxima taken from the tracks, where they are not given.

        A policy keeps the maxima that it was trained with, so that it sees other tracks in the same scale. Raises
        ConfigError for several tracks where it is of one only.
        """

    def sees(self, action: Action) -> tuple[Seen, ...]:
        """Return what the numbers of a fitted observation are, beside commands of an action."""

    def __call__(self, view: "View") -> Tensor:
        """Return the observation (N, size)."""


def create_observation(settings: Mapping[str, Any]) -> Observation:
    """Build the observation that `settings["name"]` names."""
    import racerl.env.observations as package

    return registry.create(package, settings)


def settings_of(name: str, observation: Observation) -> dict[str, Any]:
    """Return the settings that build an observation of that name again, with its maxima as they are."""
    return {"name": name, **asdict(cast(Any, observation))}


def check_maxima(**maxima: float) -> None:
    """Raise ValueError for a maximum that is no number or negative."""
    for name, value in maxima.items():
        if not isinstance(value, (int, float)) or not value >= 0:
            raise ValueError(f"{name} = {value!r}: allowed is more than 0, or 0 to take it from the track")


def actuator_terms(view: "View") -> list[Tensor]:
    """Return δ, δ_ref, the rate of the drive command, the drive command and ω, each (N,)."""
    return [view.delta, view.command[0], view.command_rate, view.command[1], view.omega]


def actuators_seen(action: Action) -> tuple[Seen, ...]:
    """Return what `actuator_terms` are."""
    unit = "A" if action.drive_mode == "motor_current" else "m/s"
    return (
        Seen("delta", "rad", action.steering_max),
        Seen("delta_ref", "rad", action.steering_max),
        Seen("drive_ref_rate", f"{unit}/s".replace("m/s/s", "m/s²"), action.rate_max),
        Seen("drive_ref", unit, action.drive_max),
        Seen("omega", "m/s", SPEED_MAX),
    )


@cache
def maxima(observation: Observation, action: Action) -> tuple[float, ...]:
    """Return what an observation's numbers are divided by."""
    return tuple(each.maximum for each in observation.sees(action))


def scaled(observation: Observation, view: "View") -> Tensor:
    """Return what a policy reads (N, size): numbers as shares of their maxima, inside ± OBSERVATION_LIMIT."""
    shares = observation(view) / view.constant(maxima(observation, view.action))
    return shares.clamp_(-OBSERVATION_LIMIT, OBSERVATION_LIMIT)
