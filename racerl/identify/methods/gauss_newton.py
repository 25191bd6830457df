"""Gauss–Newton with Levenberg–Marquardt damping, initial states eliminated window by window."""

from collections.abc import Callable
from dataclasses import dataclass

from racerl.errors import ConfigError
from racerl.estimation.levenberg_marquardt import descend
from racerl.identify.methods import Fit, require_numbers
from racerl.identify.objective import Objective, Point


@dataclass(frozen=True)
class GaussNewton:
    """Levenberg–Marquardt on the normal equations."""

    iterations: int = 100
    tolerance: float = 1e-6  # relative gain of a step below which the fit has converged
    damping: float = 1e-2

    def __post_init__(self) -> None:
        require_numbers("method", iterations=self.iterations, tolerance=self.tolerance, damping=self.damping)
        if self.iterations < 1 or not 0 < self.tolerance < 1 or self.damping <= 0:
            raise ConfigError(
                f"method: iterations = {self.iterations}, tolerance = {self.tolerance}, damping = {self.damping}; "
                "allowed is ≥ 1, 0 … 1 and > 0"
            )

    def fit(self, objective: Objective, start: Point, on_step: Callable[[int, float], None]) -> Fit:
        """Return the best point found."""
        end = descend(objective, start, self.iterations, self.tolerance, self.damping, on_step)
        return Fit(end.place, end.slope, end.steps, end.converged)
