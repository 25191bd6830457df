"""Laps of rising pace, from a gentle one to nearly the fastest possible: rungs for a car to climb.

All keep off the boundaries and leave some of the action's range for feedback; the top one assumes a little less grip.
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import astuple, dataclass, replace

import numpy as np
import torch

from racerl.env.actions import Action
from racerl.errors import OptimumError
from racerl.optimum.along import V_X
from racerl.optimum.collocation import Collocation, Guess, Solution
from racerl.optimum.corridor import Corridor
from racerl.optimum.optimum import best_start
from racerl.track.track import Track
from racerl.vehicle.vehicle import Vehicle

INTERVAL = 0.33  # of the narrowest half-width
# paces of the lower rungs, of the top one's greatest v_x: looked for near the one above, or along the line
NEAR, FAR = (0.95, 0.8), (0.6, 0.4)


@dataclass(frozen=True)
class Reserve:
    """What a rung leaves unused."""

    room: float  # of the narrowest half-width, to the boundaries
    grip: float
    rate: float  # of the drive's rate
    steering: float


BELOW = Reserve(room=0.16, grip=0.02, rate=0.4, steering=0.1)
# of the top lap: the first leaves least, and is too fast for some cars
TOPS = (Reserve(room=0.085, grip=0.008, rate=0.02, steering=0.0), Reserve(0.12, 0.015, 0.2, 0.05), BELOW)


def find_ladder(
    vehicle: Vehicle, track: Track, action: Action, corridor: Corridor, reserve: Reserve = TOPS[0]
) -> list[Solution]:
    """Return laps of rising pace, the top one with this reserve; a lower one that is not found is left out.

    Raises OptimumError when the top one is not found, or none below.
    """
    top = best_start(_problem(vehicle, track, action, corridor, reserve, np.inf))
    greatest = float(top.states[V_X].max())
    gentle = Reserve(*(max(pair) for pair in zip(astuple(BELOW), astuple(reserve), strict=True)))

    def below(paces: Sequence[float], guess: Guess | None) -> list[Solution]:
        laps: list[Solution] = []
        for pace in paces:
            problem = _problem(vehicle, track, action, corridor, gentle, pace * greatest)
            if lap := _solved(problem, [problem.guess(0.0)] if guess is None else [guess, problem.guess(0.0)]):
                laps.append(lap)
                guess = None if guess is None else lap.guess
        return laps

    with ThreadPoolExecutor(torch.get_num_threads()) as pool:  # the solver lets other threads work meanwhile
        near, far = pool.submit(below, NEAR, top.guess), pool.submit(below, FAR, None)
        lower = [*near.result(), *far.result()]
    if not lower:
        raise OptimumError("no lap below the fastest one is found; a car could not climb to it")
    return [top, *lower][::-1]


def _solved(problem: Collocation, guesses: Sequence[Guess]) -> Solution | None:
    """Return the lap from the first guess that leads to one; None where none does."""
    for guess in guesses:
        try:
            return problem.solve(guess)
        except OptimumError:
            continue
    return None


def _problem(
    vehicle: Vehicle, track: Track, action: Action, corridor: Corridor, reserve: Reserve, fastest: float
) -> Collocation:
    narrowest = float((track.width_left + track.width_right).min() / 2)
    intervals = max(60, round(corridor.length / (INTERVAL * narrowest)))
    car = replace(vehicle, friction=(1 - reserve.grip) * vehicle.friction)
    share = {"steering_max": (1 - reserve.steering) * action.steering_max}
    if action.integrated:
        share["rate_max"] = (1 - reserve.rate) * action.rate_max
    narrowed = replace(action, **share)  # type: ignore[type-var]
    return Collocation(car, narrowed, corridor, intervals, reserve.room * narrowest, fastest)
