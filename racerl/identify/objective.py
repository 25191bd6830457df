"""What a fit minimises: the mean squared error of long rollouts, and the distance from the priors.

    F(θ, x_0) = Σ_c w_c² mean(((x_c − y_c)/scale_c)²) / Σ_c w_c²  +  λ Σ ((θ − θ_0)/σ)²

The mean runs over windows and samples; every window has a free initial state x_0. λ = F_data/N makes the prior as
strong as it should be beside N independent residuals (a maximum a posteriori estimate); N counts the residuals less
their autocorrelation.
"""

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from racerl.estimation.levenberg_marquardt import bounded_step
from racerl.estimation.schur import WindowEquations
from racerl.estimation.unknowns import Unknowns
from racerl.vehicle.rollout import Rollout, Windows

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Point:
    """Parameters θ (P,) and the initial states of all windows (S, W)."""

    theta: Array
    initial: Array


@dataclass(frozen=True)
class Linearised(WindowEquations):
    """The objective at a point, and the normal equations of the windows' shares of it."""

    cost: float
    data: float
    squares: Array


class Objective:
    """F for some windows; `scale` (C,) normalises the observed channels and `weight` (C,) says what they count."""

    def __init__(
        self,
        rollout: Rollout,
        unknowns: Unknowns,
        windows: Windows,
        scale: Array,
        weight: Array,
        penalty: float = 0.0,
        still: Collection[str] = (),
    ) -> None:
        """`still`: states whose initial values are known; those of all others are free."""
        share = weight / (scale * np.sqrt((weight**2).sum() * windows.count * len(windows.measured)))
        self.windows = replace(windows, weight=np.repeat(share[:, None], windows.count, axis=1))
        self.rollout, self.unknowns, self.penalty = rollout, unknowns, penalty
        self.active = [rollout.vehicle.states.index(name) for name in rollout.active]
        self.free = np.array([name not in still for name in rollout.active])

    def start(self, theta: Array) -> Point:
        """Return the point with these parameters and the measured initial states."""
        return Point(theta, self.windows.initial)

    def prior(self, theta: Array) -> float:
        """Return the penalty λ Σ ((θ − θ_0)/σ)²."""
        return float(self.penalty * (((theta - self.unknowns.start) / self.unknowns.sigma) ** 2).sum())

    def cost(self, point: Point) -> float:
        """Return F at a point, without gradients and several times faster; infinity for an unstable rollout."""
        windows = replace(self.windows, initial=point.initial)
        with np.errstate(all="ignore"):
            data = float(self.rollout.squares(point.theta, windows).sum())
        return data + self.prior(point.theta) if np.isfinite(data) else np.inf

    def linearise(self, point: Point) -> Linearised:
        """Return cost, gradients and the Gauss–Newton matrices at a point; an unstable rollout costs infinity."""
        windows = replace(self.windows, initial=point.initial)
        with np.errstate(all="ignore"):
            equations = self.rollout.accumulate(point.theta, windows)
            data = float(equations.squares.sum())
        P = len(point.theta)
        if not np.isfinite(data) or not np.isfinite(equations.H).all():
            data = np.inf
        free = self.free  # what is known takes no step and explains nothing
        return Linearised(
            equations.H[:, :P, :P],
            equations.H[:, :P, P:] * free,
            equations.H[:, P:, P:] * np.outer(free, free) + np.diag(1.0 - free),
            equations.g[:, :P],
            equations.g[:, P:] * free,
            data + self.prior(point.theta),
            data,
            equations.squares,
        )

    def moved(self, point: Point, linearised: Linearised, theta: Array, damping: float) -> Point:
        """Return the point at other parameters, each window's initial state following by its own Gauss–Newton step."""
        initial = point.initial.copy()
        initial[self.active] += linearised.follow(theta - point.theta, damping)
        return Point(theta, initial)

    def step(self, point: Point, at: Linearised, damping: float) -> Point:
        """Return the point after one damped Gauss–Newton step inside the bounds."""
        unknowns, scale = self.unknowns, self.unknowns.sigma
        H, g = at.reduced(damping)
        stiffness = H.sum(axis=0) * np.outer(scale, scale) + self.penalty * np.eye(len(scale))
        slope = g.sum(axis=0) * scale + self.penalty * (point.theta - unknowns.start) / scale
        theta = bounded_step(stiffness, slope, point.theta, unknowns.low, unknowns.high, scale, damping)
        return self.moved(point, at, theta, damping)

    def residuals(self, point: Point) -> Array:
        """Return the unweighted residuals x − y of the observed channels, (T + 1, C, W)."""
        windows = replace(self.windows, initial=point.initial)
        return self.rollout.predict(point.theta, windows) - windows.measured
