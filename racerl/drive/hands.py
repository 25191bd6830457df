"""What holds the wheel: hands that steer and press the pedal, and may ask for something besides.

`racerl.drive.controls` has those of a person, at the keyboard or a gamepad; here are their terms and the `Script`, a
deterministic driver in their place, which follows the centreline at a speed that suits its bends.
"""

import math
from collections.abc import Sequence
from enum import Enum
from typing import Any, NamedTuple, Protocol

import torch

from racerl.drive.session import Phase, Session
from racerl.env.race import OMEGA, Race

PRACTICE = 0.5  # s that the script drives before it asks to be counted
PREVIEW = 0.2  # m ahead, where the script looks for the bend to steer for
HORIZON = 1.0  # m ahead, over which it looks for the bend to slow down for
LATERAL, FASTEST, SLOWEST = 3.0, 2.5, 0.8  # m/s², m/s, m/s
OFFSET_GAIN, HEADING_GAIN = 1.2, 1.0  # rad/m, rad/rad
SPEED_GAIN = 1.0  # full pedal per m/s


class Request(Enum):
    """What a driver may ask for."""

    START = "begin the counted session"
    PAUSE = "pause, or go on"
    PUT_BACK = "be put back on the centreline"
    MORE = "a higher current limit"
    LESS = "a lower current limit"
    QUIT = "end the drive"


class Hold(NamedTuple):
    """What the hands do now, both in −1 … 1."""

    steering: float  # share of full lock, positive to the left
    pedal: float  # from full brake to full throttle


class Hands(Protocol):
    """Steer one car."""

    name: str
    live: bool  # a person, for whom time must pass as on the clock

    def take(self, events: Sequence[Any]) -> list[Request]:
        """Take in the window's events (pygame's); return what is asked for besides what keys ask for."""

    def hold(self) -> Hold:
        """Return what is done over the next control step."""


class Script:
    """Practises for a moment, drives the counted laps and leaves."""

    name, live = "script", False

    def __init__(self, race: Race, session: Session) -> None:
        self._race, self._session = race, session
        self._wheelbase = float(race.vehicle.wheelbase)
        self._ahead = torch.linspace(0.0, HORIZON, 11)

    def take(self, events: Sequence[Any]) -> list[Request]:
        """Ask to be counted after practice, and to leave at the end."""
        if self._session.phase is Phase.FINISHED:
            return [Request.QUIT]
        practised = self._session.phase is Phase.PRACTICE and self._session.seconds >= PRACTICE
        return [Request.START] if practised else []

    def hold(self) -> Hold:
        """Steer the bend ahead and back to the centreline; drive as fast as v²κ = LATERAL allows."""
        state, (s, n, heading, _, _) = self._race.seen()
        (bend,) = self._race.frame.lookup(s + PREVIEW, self._race.frame.curvature)
        (bends,) = self._race.frame.lookup(s + self._ahead, self._race.frame.curvature)
        delta = math.atan(self._wheelbase * float(bend)) - OFFSET_GAIN * float(n) - HEADING_GAIN * float(heading)
        speed = math.sqrt(LATERAL / max(float(bends.abs().max()), 1e-3))
        pedal = SPEED_GAIN * (min(max(speed, SLOWEST), FASTEST) - float(state[OMEGA]))
        return Hold(clip(delta / self._race.action.steering_max), clip(pedal))


def clip(share: float) -> float:
    """Return a share inside ± 1."""
    return min(max(share, -1.0), 1.0)
