"""Curves in the plane: length along points, curvature from derivatives."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def arc_length(points: Array) -> Array:
    """Return the way in m along the chords from the first of points (P, 2) to each, (P,)."""
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])


def curvature(first: Array, second: Array) -> Array:
    """Return κ = (x' y'' − y' x'')/|(x', y')|³ from derivatives (P, 2) by any one parameter, positive to the left."""
    (dx, dy), (ddx, ddy) = first.T, second.T
    return np.asarray((dx * ddy - dy * ddx) / np.hypot(dx, dy) ** 3)
