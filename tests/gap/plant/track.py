"""The blind test's own circuit: a kidney of about 30 m, 2 m wide, closed and smooth.

A centre line is sampled every 5 cm or so; index and way grow anticlockwise unless it is `reversed`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial import KDTree

from tests.gap.plant.tyre import Array

HALF_WIDTH = 1.0  # m
N_POINTS = 600
CORNERS = (
    (-4.6, -3.0), (-2.0, -3.5), (1.0, -3.6), (3.8, -3.2), (5.1, -1.6), (4.5, 0.2), (2.6, 0.9), (0.8, 1.5),
    (0.0, 3.1), (-1.1, 4.6), (-3.0, 4.7), (-4.5, 3.3), (-5.2, 0.8), (-5.4, -1.5),
)  # m, knots of a periodic cubic spline  # fmt: skip


@dataclass(frozen=True)
class Track:
    """A closed centre line, (N,) each: position in m, direction of travel in rad, curvature in 1/m (left positive)."""

    x: Array
    y: Array
    heading: Array
    curvature: Array
    spacing: float  # m between points

    @property
    def length(self) -> float:
        """Length of a lap, m."""
        return self.spacing * len(self.x)

    def reversed(self) -> Track:
        """The same circuit driven the other way round."""
        return replace(
            self,
            x=self.x[::-1],
            y=self.y[::-1],
            heading=self.heading[::-1] + np.pi,
            curvature=-self.curvature[::-1],
        )


def kidney() -> Track:
    """The circuit, from its knots, resampled to equal spacing."""
    knots = np.array([*CORNERS, CORNERS[0]])
    knots[-1] = knots[0]
    chord = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(knots, axis=0).T))])
    spline = CubicSpline(chord, knots, bc_type="periodic")
    fine = np.linspace(0.0, chord[-1], 20 * N_POINTS + 1)
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(spline(fine), axis=0).T))])
    at = np.interp(np.arange(N_POINTS) * way[-1] / N_POINTS, way, fine)
    (x, y), (dx, dy), (ddx, ddy) = (spline(at, order).T for order in range(3))
    return Track(x, y, np.arctan2(dy, dx), (dx * ddy - dy * ddx) / np.hypot(dx, dy) ** 3, way[-1] / N_POINTS)


class TrackLean:
    """Ground that leans to the circuit's left side: the normal of the nearest point of the centre line, (2, B)."""

    def __init__(self, track: Track) -> None:
        self.tree = KDTree(np.column_stack([track.x, track.y]))
        self.normal = np.stack([-np.sin(track.heading), np.cos(track.heading)])

    def __call__(self, x: Array, y: Array) -> Array:
        _, nearest = self.tree.query(np.column_stack([x, y]))
        return self.normal[:, nearest]


def bowl(x: Array, y: Array) -> Array:
    """Ground around the origin whose direction of travel is anticlockwise about it: it leans to the middle, (2, B)."""
    distance = np.hypot(x, y)
    return -np.tanh(distance / 1.5) / np.maximum(distance, 1e-9) * np.stack([x, y])


def speed_profile(track: Track) -> Array:
    """Speed in m/s at a grip of 1 m/s², (N,): cornering √(1/|κ|), accelerating and braking within a friction circle."""
    squared: Array = 1.0 / np.maximum(np.abs(track.curvature), 0.02)
    for _ in range(2):  # twice round, so that the seam leaves no trace
        squared = _reachable(squared, np.abs(track.curvature), track.spacing)
        squared = _reachable(squared[::-1], np.abs(track.curvature[::-1]), track.spacing)[::-1]
    return np.sqrt(squared)


def _reachable(squared: Array, curvature: Array, spacing: float) -> Array:
    """Limit v² to what can be reached from the point before with the grip that cornering leaves over."""
    squared = squared.copy()
    for i in range(len(squared)):
        before = squared[i - 1]
        left_over = np.sqrt(max(1.0 - (before * curvature[i - 1]) ** 2, 0.0))
        squared[i] = min(squared[i], before + 2 * spacing * 0.8 * left_over)
    return squared
