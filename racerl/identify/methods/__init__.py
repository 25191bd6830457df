"""How the objective is minimised, one file each; module `gauss_newton` holds the class `GaussNewton`."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

from racerl.errors import ConfigError
from racerl.identify.objective import Linearised, Objective, Point


@dataclass(frozen=True)
class Fit:
    """Where a method ended: the point, the objective there, and how many steps it took."""

    point: Point
    linearised: Linearised
    steps: int
    converged: bool


class Method(Protocol):
    """Minimises an objective from a start; `on_step(iteration, cost)` hears of each step."""

    def fit(self, objective: Objective, start: Point, on_step: Callable[[int, float], None]) -> Fit:
        """Return the best point found."""


def require_numbers(where: str, iterations: Any, **reals: Any) -> None:
    """Raise ConfigError unless `iterations` is a whole number and the others are numbers."""
    if isinstance(iterations, bool) or not isinstance(iterations, int):
        raise ConfigError(f"{where}.iterations = {iterations}: allowed is a whole number ≥ 1")
    for name, value in reals.items():
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise ConfigError(f"{where}.{name} = {value}: a number is expected")
