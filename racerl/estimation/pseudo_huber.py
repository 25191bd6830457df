"""The pseudo-Huber loss of a window's cost: usual windows count by their cost, those far beyond by its root.

    ρ(c) = 2√2 n (√(1 + c/n) − 1),    ρ'(n) = 1

with n the cost of a usual window. A window that no vehicle foresees, a spin, does not decide alone.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def pseudo_huber(cost: Array, usual: float) -> Array:
    """Return ρ(c) of windows' costs."""
    found: Array = 2.0 * np.sqrt(2.0) * usual * (np.sqrt(1.0 + cost / usual) - 1.0)
    return found


def slope(cost: Array, usual: float) -> Array:
    """Return ρ'(c), by which windows are weighted."""
    return np.asarray(np.sqrt(2.0 / (1.0 + cost / usual)))
