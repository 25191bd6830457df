"""Windows that hang together: neighbours of one run are held out, and drawn in a bootstrap, as one block."""

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm, t

Array = NDArray[np.float64]
Index = NDArray[np.int64]
FAR = 1_000_000_000  # rows, more than any run has
CLEAR = 3.0  # standard errors by which a total must differ from zero


def stretches(run: Index, start: Index, rows: int) -> Index:
    """Return the block of every window (W,), from its run and its first row there: stretches of so many rows."""
    return np.unique(run * FAR + start // rows, return_inverse=True)[1]


def winsorised(sums: Array, outer: int) -> Array:
    """Return values (B,) with the `outer` on each side moved to their neighbours."""
    ordered = np.sort(sums)
    return np.clip(sums, ordered[outer], ordered[-1 - outer])


def standard_error(sums: Array, outer: int) -> float:
    """Return the standard error of the total of blocks (B,) once the `outer` on each side are winsorised.

    By Dixon and Tukey (1968), s √B (B − 1)/(h − 1) with h = B − 2 outer, and widened by what Student's law with h − 1
    degrees of freedom has more than the normal one at CLEAR of them. Infinite where h is below 2. Not widened where all
    blocks have one sign and are so many that this is as rare by chance, 2^−B: their spread is no doubt about the sign.
    """
    count, free = len(sums), len(sums) - 2 * outer - 1
    if free < 1:
        return np.inf
    error = float(np.std(winsorised(sums, outer), ddof=1) * np.sqrt(count))
    if abs(np.sign(sums).sum()) == count and 0.5**count <= norm.sf(CLEAR):
        return error
    return error * (count - 1) / free * float(t.ppf(norm.cdf(CLEAR), free)) / CLEAR


def counts(blocks: int, draws: int, generator: np.random.Generator) -> Array:
    """Return how often each of so many blocks is drawn, (draws, blocks), where as many are drawn with replacement."""
    drawn = generator.integers(blocks, size=(draws, blocks))
    return np.stack([np.bincount(row, minlength=blocks) for row in drawn]).astype(float)


def nested_counts(group: Index, draws: int, generator: np.random.Generator) -> Array:
    """Return the same, (draws, B), where blocks (B,) belong to groups: these are drawn first, then their own blocks."""
    members = [np.flatnonzero(group == each) for each in np.unique(group)]
    times = generator.multinomial(len(members), np.full(len(members), 1.0 / len(members)), size=draws)
    drawn = np.zeros((draws, len(group)))
    for own, often in zip(members, times.T, strict=True):
        drawn[:, own] = generator.multinomial(often * len(own), np.full(len(own), 1.0 / len(own)))
    return drawn


def resampled(sums: Array, draws: int, generator: np.random.Generator) -> Array:
    """Return the totals (draws, …) of as many blocks, drawn with replacement, as there are; `sums` (B, …)."""
    return np.asarray(counts(len(sums), draws, generator) @ sums)
