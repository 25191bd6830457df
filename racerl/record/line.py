"""A line round a track, smoother than its centreline, with the speeds that a car can drive it at.

Speeds: those of the turns, then what braking and accelerating between them allow, with the friction circle
a_x = a_max √(1 − (v²κ/(share·grip))²).
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from racerl.record.ability import Cornering
from racerl.record.drivers import Measured
from racerl.track.curve import arc_length, curvature
from racerl.track.smooth_line import smooth_line
from racerl.track.track import Track

FINE = 0.03  # m between the points of the line
SEARCH = 40  # points ahead among which the nearest is looked for
SLOWEST = 1.0  # m/s


@dataclass(frozen=True)
class Line:
    """Points at even distances round the track, each a list of M numbers."""

    spacing: float  # m
    x: list[float]  # m
    y: list[float]  # m
    yaw: list[float]  # rad
    curvature: list[float]  # 1/m
    speed: list[float]  # m/s

    def at(self, index: int, distance: float) -> int:
        """Return the index of the point `distance` metres on."""
        return (index + round(distance / self.spacing)) % len(self.x)

    def nearest(self, car: Measured, index: int) -> int:
        """Return the index of the point nearest to the car, looked for around `index`."""
        near = [(index + i) % len(self.x) for i in range(-SEARCH // 4, SEARCH)]
        return min(near, key=lambda i: (self.x[i] - car.x) ** 2 + (self.y[i] - car.y) ** 2)


def find_line(
    track: Track, cornering: Cornering, braking: float, *, share: float, margin: float, steering: float, fastest: float
) -> Line:
    """Return the line with speeds that use a share of the grip; margin in m, steering in rad, `fastest` in m/s."""
    points, _ = smooth_line(track, margin)
    chord = arc_length(points)
    spline = CubicSpline(chord, points, bc_type="periodic")
    count = round(chord[-1] / FINE)
    s = np.arange(count) * (chord[-1] / count)
    (x, y), along = spline(s).T, spline(s, 1)
    bend = curvature(along, spline(s, 2))
    # the spline's curvature is rough between its points
    window = np.hanning(round(0.4 / FINE))
    wide = np.concatenate([bend[-len(window) :], bend, bend[: len(window)]])
    bend = np.convolve(wide, window / window.sum(), mode="same")[len(window) : -len(window)]
    turning = np.clip(cornering.speed(bend, share, steering), SLOWEST, fastest)
    spacing = float(chord[-1] / count)
    speed = _drivable(turning, bend, spacing, share * braking, share * cornering.grip)
    yaw = np.arctan2(along[:, 1], along[:, 0])
    return Line(spacing, x.tolist(), y.tolist(), yaw.tolist(), bend.tolist(), speed.tolist())


def _drivable(
    speed: NDArray[np.float64], bend: NDArray[np.float64], spacing: float, longitudinal: float, lateral: float
) -> NDArray[np.float64]:
    """Lower speeds until none asks for more than the friction circle (m/s²) gives between two points."""
    speed = speed.copy()
    count = len(speed)
    for step in (-1, 1):  # braking towards a turn, accelerating out of it; twice round
        for k in range(2 * count):
            i = (step * k) % count
            used = min(1.0, speed[i] ** 2 * abs(bend[i]) / lateral)
            gained = 2.0 * longitudinal * math.sqrt(1.0 - used**2) * spacing
            j = (i + step) % count
            speed[j] = min(speed[j], math.sqrt(speed[i] ** 2 + gained))
    return speed
