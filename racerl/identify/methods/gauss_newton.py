"""Gauss–Newton with Levenberg–Marquardt damping, initial states eliminated window by window.

With θ scaled by the priors' deviations, a step solves (H + λ + μ diag H) Δ = −g for the parameters that are not pushed
against a bound; μ falls fivefold after a step that helps and rises fivefold until one does.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from racerl.errors import ConfigError
from racerl.identify.methods import Fit, require_numbers
from racerl.identify.objective import Linearised, Objective, Point

DAMPING_LIMIT = 1e8


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
        point, damping = start, self.damping
        at = objective.linearise(point)
        for iteration in range(1, self.iterations + 1):
            while True:
                candidate = objective.moved(point, at, self._step(objective, point, at, damping), damping)
                # its gradients are only asked for where it is better
                if objective.cost(candidate) <= at.cost and np.isfinite((there := objective.linearise(candidate)).cost):
                    break
                damping *= 5
                if damping > DAMPING_LIMIT:
                    return Fit(point, at, iteration, bool(np.isfinite(at.cost)))
            gain = (at.cost - there.cost) / max(at.cost, 1e-300)
            point, at, damping = candidate, there, max(damping / 5, 1e-9)
            on_step(iteration, at.cost)
            if gain < self.tolerance:
                return Fit(point, at, iteration, True)
        return Fit(point, at, self.iterations, False)

    @staticmethod
    def _step(objective: Objective, point: Point, at: Linearised, damping: float) -> NDArray[np.float64]:
        """Return the parameters after one damped step inside the bounds."""
        unknowns = objective.unknowns
        H, g = at.reduced(damping)
        scale = unknowns.sigma
        A = H.sum(axis=0) * np.outer(scale, scale) + objective.penalty * np.eye(len(scale))
        b = g.sum(axis=0) * scale + objective.penalty * (point.theta - unknowns.start) / scale
        A += damping * np.diag(np.diag(A)) + 1e-12 * np.trace(A) / len(A) * np.eye(len(A))
        free = ~(((point.theta <= unknowns.low) & (b >= 0)) | ((point.theta >= unknowns.high) & (b <= 0)))
        step = np.zeros_like(b)
        step[free] = -np.linalg.solve(A[np.ix_(free, free)], b[free])
        return unknowns.clip(point.theta + step * scale)
