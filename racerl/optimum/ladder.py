"""Laps of rising pace, from a gentle one to nearly the fastest possible: rungs for a car to climb.

All keep off the boundaries and leave some of the action's range for feedback; the top one assumes a little less grip.
"""

from dataclasses import dataclass, replace

import numpy as np

from racerl.env.actions import Action
from racerl.errors import OptimumError
from racerl.optimum.along import V_X
from racerl.optimum.collocation import Collocation, Guess, Solution
from racerl.optimum.corridor import Corridor
from racerl.optimum.optimum import coarse_mesh, starts
from racerl.track.track import Track
from racerl.vehicle.vehicle import Vehicle

PACES = (0.4, 0.55, 0.7, 0.8, 0.9, 0.96)  # of the lower rungs, of the greatest v_x of the gentlest one without a limit


@dataclass(frozen=True)
class Reserve:
    """What a rung leaves unused."""

    room: float  # of the narrowest half-width, to the boundaries
    grip: float
    rate: float  # of the drive's rate
    steering: float


# of rungs without a limit of pace: the first leaves least, and is too fast for some cars; the last holds for all below
FULL = (Reserve(0.085, 0.008, 0.02, 0.0), Reserve(0.12, 0.015, 0.2, 0.05), Reserve(0.16, 0.02, 0.4, 0.1))


def find_ladder(vehicle: Vehicle, track: Track, action: Action, corridor: Corridor) -> list[Solution]:
    """Return laps of rising pace; one that is not found is left out.

    Raises OptimumError where no lap without a limit of pace is found.
    """

    def problem(reserve: Reserve, fastest: float = np.inf) -> Collocation:
        return _problem(vehicle, track, action, corridor, reserve, fastest)

    laps: list[Solution] = []  # of falling pace
    for reserve in FULL:
        if laps:
            laps += _solved(problem(reserve), laps[-1].guess)
        else:
            laps += _started(problem(reserve), last=reserve is FULL[-1])
    greatest, guess = float(laps[-1].states[V_X].max()), None
    for pace in PACES:
        limited = problem(FULL[-1], pace * greatest)
        if lap := _solved(limited, *([guess] if guess else []), limited.guess(0.0)):
            laps, guess = laps + lap, lap[0].guess
    return sorted(laps, key=lambda lap: -lap.time)


def _started(problem: Collocation, last: bool) -> list[Solution]:
    """Return the best lap of all first guesses; none where there is none, an OptimumError if it is the `last` hope."""
    try:
        return starts(problem)[:1]
    except OptimumError:
        if last:
            raise
        return []


def _solved(problem: Collocation, *guesses: Guess) -> list[Solution]:
    """Return the lap from the first guess that leads to one; none where none does."""
    for guess in guesses:
        try:
            return [problem.solve(guess)]
        except OptimumError:
            continue
    return []


def _problem(
    vehicle: Vehicle, track: Track, action: Action, corridor: Corridor, reserve: Reserve, fastest: float
) -> Collocation:
    car = replace(vehicle, friction=(1 - reserve.grip) * vehicle.friction)
    share = {"steering_max": (1 - reserve.steering) * action.steering_max}
    if action.integrated:
        share["rate_max"] = (1 - reserve.rate) * action.rate_max
    narrowed = replace(action, **share)  # type: ignore[type-var]
    room = reserve.room * track.min_half_width
    return Collocation(car, narrowed, corridor, coarse_mesh(corridor, track), room, fastest)
