"""Levenberg–Marquardt: damped Gauss–Newton steps, none of which goes up.

The damping μ falls after a step that helps at once and rises until one does. A step that gains next to nothing ends the
descent only where a nearly undamped one was tried from the same place: a step that is heavily damped gains little
anywhere.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
RISE, FALL = 8.0, 10.0  # of μ after a step that does not help, and after one that does at once
LEAST, WORST = 1e-9, 1e8  # μ; beyond the worst no step helps any more
FREE = 1e-2  # μ up to which a step counts as undamped
ROUND = 1e-12  # of the mean stiffness, added to each: what is in no way determined stays


class Costly(Protocol):
    """What a place is like: its cost, and whatever a step from it is made of."""

    @property
    def cost(self) -> float:
        """F, infinite where the model blows up."""


Place = TypeVar("Place")
Slope = TypeVar("Slope", bound=Costly)


class Landscape(Protocol[Place, Slope]):
    """A cost over places."""

    def linearise(self, place: Place) -> Slope:
        """Return the cost at a place, with its derivatives."""

    def cost(self, place: Place) -> float:
        """Return the cost at a place, without derivatives."""

    def step(self, place: Place, slope: Slope, damping: float) -> Place:
        """Return where a damped step leads."""


@dataclass(frozen=True)
class Descent(Generic[Place, Slope]):
    """Where a descent ended: the place and its slope, the steps taken, and why it is no minimum ("" if it is)."""

    place: Place
    slope: Slope
    steps: int
    why: str

    @property
    def converged(self) -> bool:
        """Whether an undamped step gains nothing there."""
        return not self.why


def descend(
    landscape: Landscape[Place, Slope],
    start: Place,
    iterations: int,
    tolerance: float,
    damping: float = 1e-3,
    on_step: Callable[[int, float], None] = lambda number, cost: None,
) -> Descent[Place, Slope]:
    """Descend from a start until a step takes less than `tolerance` of the cost; `on_step` hears of each."""
    place, at = start, landscape.linearise(start)
    for number in range(1, iterations + 1):
        free, factor = damping <= FREE, 1.0 / FALL
        while (found := _tried(landscape, place, at, damping)) is None:
            damping, factor = damping * RISE, 1.0
            if damping > WORST:
                return Descent(place, at, number, "" if np.isfinite(at.cost) else "the model blows up")
        gain = (at.cost - found[1].cost) / max(at.cost, 1e-300)
        place, at = found
        on_step(number, at.cost)
        if gain < tolerance and free:
            return Descent(place, at, number, "")
        if gain < tolerance:
            factor = FREE / damping
        damping = max(damping * factor, LEAST)
    return Descent(place, at, iterations, f"the cost still falls after {iterations} steps")


def _tried(landscape: Landscape[Place, Slope], place: Place, at: Slope, damping: float) -> tuple[Place, Slope] | None:
    """Return where a damped step leads and what is there; None where that is no better."""
    trial = landscape.step(place, at, damping)
    if landscape.cost(trial) > at.cost:  # a fifth of the work of the derivatives
        return None
    there = landscape.linearise(trial)
    return (trial, there) if np.isfinite(there.cost) and there.cost <= at.cost else None


def bounded_step(H: Array, g: Array, theta: Array, low: Array, high: Array, scale: Array, damping: float) -> Array:
    """Return θ after a damped step inside the bounds; H (N, N) and g (N,) over θ/scale.

    What stands at a bound and is pushed against it stays there.
    """
    A = H + damping * np.diag(np.diag(H)) + ROUND * np.trace(H) / max(len(H), 1) * np.eye(len(H))
    free = ~(((theta <= low) & (g >= 0)) | ((theta >= high) & (g <= 0)))
    step = np.zeros_like(g)
    step[free] = -np.linalg.solve(A[np.ix_(free, free)], g[free])
    moved: Array = np.clip(theta + step * scale, low, high)
    return moved
