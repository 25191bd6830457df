"""How well a vehicle predicts a log: errors of rollouts that start from the measured state.

RMSE at the horizon h is over all samples 1 … h of all rollouts, one started every few samples. Beside it stands what
holding the first state would give.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from racerl.identify.windows import Cut
from racerl.vehicle.rollout import Rollout

Array = NDArray[np.float64]
Table = dict[str, dict[str, float | None]]

HORIZONS = (1, 5, 20, 50, 85)  # samples
START_EVERY = 4  # samples between the starts of scored rollouts


class ErrorSum:
    """Squared errors by sample of the horizon, summed over rollouts, (T, C)."""

    def __init__(self, observed: Sequence[str], horizons: Sequence[int]) -> None:
        self.observed, self.horizons = list(observed), list(horizons)
        self.total = np.zeros((max(self.horizons), len(self.observed)))
        self.count = 0

    def add(self, errors: Array) -> None:
        """Add the errors (T + 1, C, W) of rollouts; the first sample, the start itself, does not count."""
        self.total += (np.where(np.isfinite(errors), errors, np.inf)[1:] ** 2).sum(axis=2)
        self.count += errors.shape[2]

    def rmse(self) -> Table:
        """Return {horizon: {channel: RMSE}} in the channels' units; None where a rollout diverged."""
        table: Table = {}
        for horizon in self.horizons:
            mean = self.total[:horizon].mean(axis=0) / max(self.count, 1)
            table[str(horizon)] = {
                name: float(np.sqrt(value)) if np.isfinite(value) else None
                for name, value in zip(self.observed, mean, strict=True)
            }
        return table


def horizons_within(length: int) -> list[int]:
    """Return the horizons that a window of `length` intervals can answer for, the window itself included."""
    return sorted({h for h in HORIZONS if h < length} | {length})


def rollout_errors(rollout: Rollout, theta: Array, cut: Cut) -> Array:
    """Return simulated minus measured channels (T + 1, C, W), from the measured initial states."""
    with np.errstate(all="ignore"):
        return rollout.predict(theta, cut.windows) - cut.windows.measured


def held_errors(cut: Cut) -> Array:
    """Return the errors of holding each window's first sample."""
    return cut.windows.measured[:1] - cut.windows.measured
