"""When an episode ends for good.

`OffTrack`   the centre of gravity leaves the track, or the car spins (|u| > π/2): training. The paper names the first
             only; but a policy can gain a little by turning backwards in the hairpin, where evaluation sees a crash.
`Crash`      more than 0.2 m off track, a spin (|u| > π/2) or a stop: evaluation, which lets a car return by itself.
"""

import math
from typing import Protocol

import torch
from torch import Tensor

CRASH_DISTANCE = 0.2  # m beyond the boundary
STOP_SPEED = 0.1  # m/s
QUARTER_TURN = math.pi / 2  # rad
LEVER = 0.33  # m of clearance per rad left until a spin; about a wheelbase
STOP_TIME = 1.0  # s below that speed


class Situation(Protocol):
    """What decides it, of N cars, each (N,): a race has it, and so has a recorded drive."""

    @property
    def margin(self) -> Tensor:
        """Distance to the nearer boundary in m."""

    @property
    def heading(self) -> Tensor:
        """Heading against the centreline in rad."""

    @property
    def still_time(self) -> Tensor:
        """Time since the car last moved in s."""


class Termination(Protocol):
    """Decides which cars' episodes end."""

    def __call__(self, race: Situation) -> Tensor:
        """Return a mask (N,)."""


class OffTrack:
    """Ends where |n| > W, or where the car spins."""

    def __call__(self, race: Situation) -> Tensor:
        """Return the cars beyond a boundary or turned around."""
        return (race.margin < 0) | _spun(race)


class Crash:
    """Ends at a crash only."""

    def __call__(self, race: Situation) -> Tensor:
        """Return the cars far off, spun or standing."""
        return (race.margin < -CRASH_DISTANCE) | _spun(race) | (race.still_time > STOP_TIME)


def clearance(race: Situation) -> Tensor:
    """Return how far cars are from leaving the track or spinning, in m, (N,); it has a slope in the state."""
    return torch.minimum(race.margin, LEVER * (QUARTER_TURN - race.heading.abs()))


def _spun(race: Situation) -> Tensor:
    return race.heading.abs() > QUARTER_TURN
