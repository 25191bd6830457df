"""Which windows a fit sees and which it is judged by: whole runs held out, or stretches where runs are few."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from racerl.identify.windows import Cut

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Fold:
    """A share of the driving that is held out: from `low` up to `high` (rows) in each of some runs."""

    runs: tuple[int, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]

    def unseen(self, cut: Cut) -> Mask:
        """Return the windows that lie inside what is held out."""
        length = len(cut.windows.inputs)
        return self._any(cut, lambda low, high: (cut.start >= low) & (cut.start + length < high))

    def seen(self, cut: Cut) -> Mask:
        """Return the windows that share no sample with what is held out."""
        length = len(cut.windows.inputs)
        return ~self._any(cut, lambda low, high: (cut.start + length >= low) & (cut.start < high))

    def _any(self, cut: Cut, inside: Callable[[float, float], Mask]) -> Mask:
        held = np.zeros(cut.windows.count, dtype=bool)
        for run, low, high in zip(self.runs, self.low, self.high, strict=True):
            held |= (cut.run == run) & inside(low, high)
        return held


def deal(cut: Cut, count: int) -> tuple[list[Fold], str]:
    """Return `count` folds that hold out every window once, and a line that says how.

    Whole runs are dealt by length; with fewer runs than folds, each run is held out in stretches, and windows across
    two of these are never held out.
    """
    runs, windows = np.unique(cut.run, return_counts=True)
    if len(runs) >= count:
        order = runs[np.argsort(-windows, kind="stable")]
        dealt = [tuple(order[number::count].tolist()) for number in range(count)]
        folds = [Fold(held, (0.0,) * len(held), (np.inf,) * len(held)) for held in dealt]
        return folds, f"whole runs, in {count} folds"
    rows = [float(cut.start[cut.run == run].max() + len(cut.windows.inputs) + 1) for run in runs]
    folds = [
        Fold(
            tuple(runs.tolist()),
            tuple(length * number / count for length in rows),
            tuple(length * (number + 1) / count for length in rows),
        )
        for number in range(count)
    ]
    return folds, f"stretches of the runs, in {count} folds; there are too few runs to hold out whole ones"
