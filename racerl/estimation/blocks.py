"""Windows that hang together: neighbours of one run are held out, and drawn in a bootstrap, as one block."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.int64]
FAR = 1_000_000_000  # rows, more than any run has


def stretches(run: Index, start: Index, rows: int) -> Index:
    """Return the block of every window (W,), from its run and its first row there: stretches of so many rows."""
    return np.unique(run * FAR + start // rows, return_inverse=True)[1]


def counts(blocks: int, draws: int, generator: np.random.Generator) -> Array:
    """Return how often each of so many blocks is drawn, (draws, blocks), where as many are drawn with replacement."""
    drawn = generator.integers(blocks, size=(draws, blocks))
    return np.stack([np.bincount(row, minlength=blocks) for row in drawn]).astype(float)


def resampled(sums: Array, draws: int, generator: np.random.Generator) -> Array:
    """Return the totals (draws, …) of as many blocks, drawn with replacement, as there are; `sums` (B, …)."""
    return np.asarray(counts(len(sums), draws, generator) @ sums)
