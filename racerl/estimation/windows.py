"""Where the windows of a run begin."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.int64]


def window_starts(
    rows: int,
    length: int,
    stride: int,
    speed: Array | None = None,
    slowest: float = 0.0,
    before: int = 0,
    after: int = 0,
) -> Index:
    """Return the first rows of windows of `length` intervals in a run of so many rows, one every `stride` rows.

    `before` and `after` rows of the run stay outside of every window. Windows in which the `speed` (rows,) is not above
    `slowest` throughout are left out.
    """
    starts = np.arange(before, rows - length - after, stride)
    if speed is None or not len(starts):
        return starts
    moving: Index = starts[(speed[starts[:, None] + np.arange(length + 1)] > slowest).all(axis=1)]
    return moving
