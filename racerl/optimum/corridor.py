"""The free space of a track seen from a smooth line inside it, in coordinates that are regular everywhere.

Where a centreline turns tighter than the track is wide, 1 − κn vanishes inside the track, and the track coordinate with
it. The line here is smoother; the room to either side of it is found by walking outwards along its normals until the
race's own projection says that the boundary is reached, or 1 − κn becomes small.
"""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.interpolate import BSpline, make_interp_spline

from racerl.track.curve import arc_length, curvature
from racerl.track.frenet import FrenetFrame
from racerl.track.smooth_line import smooth_line
from racerl.track.track import Track

MARGIN = 0.3  # of the narrowest half-width, left to the boundary by the line
STEP = 0.01  # m of the walk outwards
LEAST_STRETCH = 0.1  # 1 − κn
OVERSAMPLING = 20

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Stretch:
    """The line and the room beside it at some places, each of shape (M,)."""

    s: Array  # m along the line
    x: Array  # m
    y: Array  # m
    yaw: Array  # rad, unwrapped
    curvature: Array  # 1/m
    low: Array  # m, the least n inside the track
    high: Array  # m, the greatest


class Corridor:
    """A smooth line round a track and the room to either side of it."""

    def __init__(self, track: Track) -> None:
        points, centre = smooth_line(track, MARGIN * track.min_half_width)
        chord = arc_length(points)
        self._spline: BSpline = make_interp_spline(chord, points, k=5, bc_type="periodic")
        self._u = np.linspace(0.0, chord[-1], OVERSAMPLING * len(points) + 1)
        speed = np.hypot(*self._spline(self._u, 1).T)
        self._arc = np.concatenate([[0.0], np.cumsum((speed[1:] + speed[:-1]) / 2 * np.diff(self._u))])
        self._centre = np.interp(self._u, chord, centre)
        self._frame = FrenetFrame(track, dtype=torch.float64)
        self.length = float(self._arc[-1])
        self._known: dict[bytes, Stretch] = {}  # by their grids

    def along(self, centre: Array) -> Array:
        """Return the line's s beside places (M,) of the centreline, both in m."""
        u = np.interp(centre, self._centre, self._u)
        return np.interp(u, self._u, self._arc)

    def as_track(self, spacing: float) -> Track:
        """Return the line as a track of its own, with the room beside it."""
        count = round(self.length / spacing)
        stretch = self.at(np.linspace(0.0, self.length, count, endpoint=False))
        yaw = np.arctan2(np.sin(stretch.yaw), np.cos(stretch.yaw))
        return Track("line", self.length, stretch.x, stretch.y, yaw, stretch.curvature, stretch.high, -stretch.low)

    def at(self, s: Array) -> Stretch:
        """Return the line and the room beside it at s (M,) in m; kept, as many laps are looked for on one grid."""
        grid = s.tobytes()
        if grid not in self._known:
            self._known[grid] = self._found(s)
        return self._known[grid]

    def _found(self, s: Array) -> Stretch:
        u = np.interp(np.mod(s, self.length), self._arc, self._u)
        (x, y), along = self._spline(u).T, self._spline(u, 1)
        yaw, bend = np.unwrap(np.arctan2(along[:, 1], along[:, 0])), curvature(along, self._spline(u, 2))
        centre = np.interp(u, self._u, self._centre)
        left, right = (self._room(x, y, yaw, bend, centre, side) for side in (1, -1))
        return Stretch(s, x, y, yaw, bend, -right, left)

    def _room(self, x: Array, y: Array, yaw: Array, bend: Array, centre: Array, side: int) -> Array:
        """Return the way in m from the line to the boundary on one side."""
        frame = self._frame
        limit = float(torch.max(frame.width_left + frame.width_right))
        room = np.full(len(x), limit)
        walking = np.ones(len(x), dtype=bool)
        s, before = torch.as_tensor(centre), np.zeros(len(x))
        for n in np.arange(0.0, limit, STEP):
            foot = frame.project(
                torch.as_tensor(x - side * n * np.sin(yaw)), torch.as_tensor(y + side * n * np.cos(yaw)), s
            )
            s = foot.s
            left, right = frame.lookup(s, frame.width_left, frame.width_right)
            left, right = left - foot.n, right + foot.n
            margin = torch.minimum(left, right).numpy()
            reached = walking & (margin < 0)
            room[reached] = np.maximum(0.0, n - STEP + STEP * (before / (before - margin))[reached])
            folded = walking & ~reached & (1.0 - side * bend * n < LEAST_STRETCH)
            room[folded] = max(0.0, n - STEP)
            walking &= ~reached & ~folded
            if not walking.any():
                break
            before = margin
        return room
