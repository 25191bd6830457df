"""How much later one channel moves than another: the shift in time at which they agree best."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from racerl.data.log import Log

Array = NDArray[np.float64]

MAX_LAG = 0.25  # s searched to either side
ENOUGH = 300  # samples that an estimate needs


class Lag(NamedTuple):
    """A measured lag in s, and the share (or correlation) explained with and without it."""

    seconds: float
    best: float
    unshifted: float


def smoothing(log: Log) -> int:
    """Return the window of the lag estimators in samples: 0.15 s, odd."""
    return max(5, int(0.15 / log.dt) | 1)


def reach(log: Log) -> int:
    """Return the largest shift that is tried, in samples."""
    return round(MAX_LAG / log.dt)


def best_lag(scores: Sequence[float], dt: float) -> Lag:
    """Return the lag whose score is highest; `scores` are those of all shifts from the earliest to the latest."""
    middle, k = len(scores) // 2, int(np.argmax(scores))
    return Lag(round((k - middle) * dt, 6), scores[k], scores[middle])


def correlation_lag(log: Log, first: str, second: str) -> Lag | None:
    """Return how much later the second channel moves than the first, by their greatest correlation."""
    runs = [run for run in log.runs() if len(run) >= 4 * reach(log)]
    return correlated([(run[first].to_numpy(), run[second].to_numpy()) for run in runs], reach(log), log.dt)


def correlated(pairs: Sequence[tuple[Array, Array]], reach: int, dt: float) -> Lag | None:
    """Return how much later the second of each pair (rows,) moves than the first; None where too little does."""
    if sum(len(a) for a, _ in pairs) < ENOUGH:
        return None
    target = np.concatenate([b[reach : len(b) - reach] for _, b in pairs])
    scores = []
    for shift in range(-reach, reach + 1):
        moved = np.concatenate([a[reach - shift : len(a) - reach - shift] for a, _ in pairs])
        if moved.std() < 1e-6 or target.std() < 1e-6:
            return None
        scores.append(float(np.corrcoef(moved, target)[0, 1]))
    return best_lag(scores, dt)
