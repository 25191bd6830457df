"""How the objective is minimised, one file each; module `gauss_newton` holds the class `GaussNewton`."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from racerl.identify.objective import Linearised, Objective, Point


@dataclass(frozen=True)
class Fit:
    """Where a method ended: the point, the objective there, and how many passes over the data it took."""

    point: Point
    linearised: Linearised
    iterations: int
    converged: bool


class Method(Protocol):
    """Minimises an objective from a start; `on_step(iteration, cost)` hears of each step."""

    def fit(self, objective: Objective, start: Point, on_step: Callable[[int, float], None]) -> Fit:
        """Return the best point found."""
