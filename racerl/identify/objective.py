"""What a fit minimises: the mean squared error of long rollouts, and the distance from the priors.

    F(θ, x_0) = Σ_c w_c² mean(((x_c − y_c)/scale_c)²) / Σ_c w_c²  +  λ Σ ((θ − θ_0)/σ)²

The mean runs over windows and samples; every window has a free initial state x_0. λ = F_data/N makes the prior as
strong as it should be beside N independent residuals (a maximum a posteriori estimate); N counts the residuals less
their autocorrelation.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from racerl.identify.unknowns import Unknowns
from racerl.vehicle.rollout import Rollout, Windows

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Point:
    """Parameters θ (P,) and the initial states of all windows (S, W)."""

    theta: Array
    initial: Array


@dataclass(frozen=True)
class Linearised:
    """The objective at a point. Shares of the windows: H over θ, θ × x_0 and x_0, and the gradients."""

    cost: float
    data: float
    squares: Array
    tt: Array
    tx: Array
    xx: Array
    t: Array
    x: Array

    def reduced(self, damping: float = 0.0) -> tuple[Array, Array]:
        """Return H (W, P, P) and gradient (W, P) over θ with each window's initial state eliminated."""
        inverse = self.inverse(damping)
        gain = self.tx @ inverse
        return self.tt - gain @ self.tx.transpose(0, 2, 1), self.t - np.einsum("wpx,wx->wp", gain, self.x)

    def inverse(self, damping: float) -> Array:
        """Return the damped inverse of the initial states' H, (W, A, A)."""
        diagonal = np.einsum("waa->wa", self.xx)
        ridge = damping * diagonal + 1e-9 * diagonal.max(axis=1, keepdims=True) + 1e-300
        return np.linalg.inv(self.xx + ridge[:, :, None] * np.eye(self.xx.shape[1]))


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
        threads: int = 1,
    ) -> None:
        share = weight / (scale * np.sqrt((weight**2).sum() * windows.count * len(windows.measured)))
        self.windows = replace(windows, weight=np.repeat(share[:, None], windows.count, axis=1))
        self.rollout, self.unknowns, self.penalty, self.threads = rollout, unknowns, penalty, threads
        self.active = [rollout.vehicle.states.index(name) for name in rollout.active]

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
            data = float(self.rollout.squares(point.theta, windows, self.threads).sum())
        return data + self.prior(point.theta) if np.isfinite(data) else np.inf

    def linearise(self, point: Point) -> Linearised:
        """Return cost, gradients and the Gauss–Newton matrices at a point; an unstable rollout costs infinity."""
        windows = replace(self.windows, initial=point.initial)
        with np.errstate(all="ignore"):
            equations = self.rollout.accumulate(point.theta, windows, self.threads)
            data = float(equations.squares.sum())
        P = len(point.theta)
        if not np.isfinite(data) or not np.isfinite(equations.H).all():
            data = np.inf
        return Linearised(
            data + self.prior(point.theta),
            data,
            equations.squares,
            equations.H[:, :P, :P],
            equations.H[:, :P, P:],
            equations.H[:, P:, P:],
            equations.g[:, :P],
            equations.g[:, P:],
        )

    def moved(self, point: Point, linearised: Linearised, theta: Array, damping: float) -> Point:
        """Return the point at other parameters, each window's initial state following by its own Gauss–Newton step."""
        gradient = linearised.x + np.einsum("wpx,p->wx", linearised.tx, theta - point.theta)
        step = -np.einsum("wxy,wy->wx", linearised.inverse(damping), gradient)
        initial = point.initial.copy()
        initial[self.active] += step.T
        return Point(theta, initial)

    def residuals(self, point: Point) -> Array:
        """Return the unweighted residuals x − y of the observed channels, (T + 1, C, W)."""
        windows = replace(self.windows, initial=point.initial)
        return self.rollout.predict(point.theta, windows, self.threads) - windows.measured


def independent_residuals(residuals: Array) -> float:
    """Return how many independent numbers the residuals (T, C, W) are worth: Σ_c T·W/τ_c.

    τ = 1 + 2 Σ ρ_k is the integrated autocorrelation time of a channel, summed until ρ falls below 0.05.
    """
    length, channels, count = residuals.shape
    total = 0.0
    for c in range(channels):
        e = residuals[:, c]
        power = (e**2).mean()
        tau = 1.0
        for lag in range(1, length):
            rho = (e[lag:] * e[:-lag]).mean() / power if power > 0 else 0.0
            if rho < 0.05:
                break
            tau += 2.0 * rho
        total += length * count / tau
    return total
