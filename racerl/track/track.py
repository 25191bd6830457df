"""A closed centreline with widths on both sides, tabulated finely over arc length.

The centreline is a periodic quintic spline that passes the given points within a rounding error of `SMOOTHING` (rms),
so that curvature and its slope are continuous; it is sampled every `SPACING` metres. Curvature κ is positive to the
left; the lateral offset n is positive to the left of the line.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_simpson
from scipy.interpolate import BSpline, PchipInterpolator, splprep

from racerl.errors import TrackError
from racerl.track.curve import arc_length, curvature

SPACING = 0.04  # m, aimed at; the length is divided evenly
SMOOTHING = 1e-3  # m
MIN_POINTS = 8
MAX_POINTS = 200_000
MAX_LENGTH = 10_000.0  # m
MAX_WIDTH = 1_000.0  # m, to either side
OVERSAMPLING = 8

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Track:
    """Tables over arc length s = i·spacing, i = 0 … M−1, each of shape (M,)."""

    name: str
    length: float  # m
    x: Array  # m
    y: Array  # m
    yaw: Array  # rad, in (−π, π]
    curvature: Array  # 1/m, positive to the left
    width_left: Array  # m
    width_right: Array  # m

    @property
    def spacing(self) -> float:
        """Distance between table entries in m."""
        return self.length / len(self.x)

    @property
    def max_curvature(self) -> float:
        """Largest |κ| in 1/m."""
        return float(np.abs(self.curvature).max())

    @property
    def max_half_width(self) -> float:
        """Largest half of the total width in m."""
        return float((self.width_left + self.width_right).max() / 2)

    @property
    def min_half_width(self) -> float:
        """Smallest half of the total width in m."""
        return float((self.width_left + self.width_right).min() / 2)

    def boundary(self, side: int) -> tuple[Array, Array]:
        """Return x, y of the left (side = 1) or right (side = −1) boundary in m."""
        offset = self.width_left if side > 0 else -self.width_right
        return self.x - offset * np.sin(self.yaw), self.y + offset * np.cos(self.yaw)


def build_track(name: str, points: Array, width_right: Array, width_left: Array) -> Track:
    """Make a track from centreline points (P, 2) in m and widths (P,) in m; the last point joins the first.

    Raises TrackError for too few points, non-finite numbers, widths that are not positive and lines that do not close.
    """
    points, width_right, width_left = _without_repeats(name, points, width_right, width_left)
    _check(name, points, width_right, width_left)
    closed = np.vstack([points, points[:1]])
    chord = arc_length(closed)
    (knots, coefficients, degree), _ = splprep(closed.T, u=chord, k=5, s=len(points) * SMOOTHING**2, per=True)
    spline = BSpline(knots, np.asarray(coefficients).T, degree)

    fine = np.linspace(0.0, chord[-1], OVERSAMPLING * max(len(points), round(chord[-1] / SPACING)) + 1)
    speed = np.hypot(*spline(fine, 1).T)
    arc = cumulative_simpson(speed, x=fine, initial=0.0)
    length = float(arc[-1])
    if not length <= MAX_LENGTH:  # between points that lie far apart a spline may swing
        raise TrackError(
            f"track {name}: the line through its points is {length:.3g} m long; look for points that are off"
        )
    s = np.arange(max(MIN_POINTS, round(length / SPACING))) * (length / max(MIN_POINTS, round(length / SPACING)))
    u = np.interp(s, arc, fine)

    (x, y), along = spline(u).T, spline(u, 1)
    return Track(
        name=name,
        length=length,
        x=x,
        y=y,
        yaw=np.arctan2(along[:, 1], along[:, 0]),
        curvature=curvature(along, spline(u, 2)),
        width_left=_periodic_widths(chord, width_left, u),
        width_right=_periodic_widths(chord, width_right, u),
    )


def _without_repeats(name: str, points: Array, *widths: Array) -> tuple[Array, ...]:
    """Drop consecutive points that coincide, the closing repetition of the first point included."""
    if points.ndim != 2 or points.shape[1] != 2:
        raise TrackError(f"track {name}: points of shape {points.shape}, (P, 2) was expected")
    if not all(np.isfinite(table).all() for table in (points, *widths)):
        raise TrackError(f"track {name}: holds NaN or infinite numbers; remove those points")
    keep = np.hypot(*(points - np.roll(points, 1, axis=0)).T) > 1e-6
    keep[0] = True
    if len(points) > 1 and np.hypot(*(points[-1] - points[0])) <= 1e-6:
        keep[-1] = False
    return points[keep], *(width[keep] for width in widths)


def _check(name: str, points: Array, width_right: Array, width_left: Array) -> None:
    if not MIN_POINTS <= len(points) <= MAX_POINTS:
        raise TrackError(f"track {name}: {len(points)} distinct points, allowed is {MIN_POINTS} … {MAX_POINTS}")
    for side, width in (("right", width_right), ("left", width_left)):
        if width.min() <= 0:
            i = int(width.argmin())
            raise TrackError(f"track {name}: {side} width {width[i]:g} m at point {i}; widths must be positive")
        if width.max() > MAX_WIDTH:
            i = int(width.argmax())
            raise TrackError(
                f"track {name}: {side} width {width[i]:g} m at point {i}, at most {MAX_WIDTH:g} m are read"
            )
    steps = np.hypot(*np.diff(points, axis=0).T)
    gap = float(np.hypot(*(points[-1] - points[0])))
    allowed = max(5.0 * float(np.median(steps)), 2.0 * float(steps.max()))
    if gap > allowed:
        raise TrackError(
            f"track {name}: does not close: {gap:.2f} m from the last point to the first, allowed is {allowed:.2f} m; "
            "append the missing points"
        )
    if steps.sum() + gap > MAX_LENGTH:
        raise TrackError(f"track {name}: {steps.sum() + gap:.0f} m long, at most {MAX_LENGTH:.0f} m; is it in metres?")


def _periodic_widths(chord: Array, width: Array, u: Array) -> Array:
    """Interpolate widths monotonically (never below their smallest value) and periodically."""
    period = chord[-1]
    knots = np.concatenate([chord[-3:-1] - period, chord, chord[1:3] + period])
    values = np.concatenate([width[-2:], width, width[:1], width[1:3]])
    return np.asarray(PchipInterpolator(knots, values)(u))
