"""A closed line inside a track, smoother than its centreline.

Its offsets n from the centreline minimise ∫κ² ds, linearised about the last solution a few times over, with |n| at most
the half-width less a margin. Towards the centre of a bend that is wider than its radius points crowd and the linearised
problem goes astray; there n may be kept to a share of the radius. Of all lines, of every pass and several shares, the
best is taken.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from racerl.track.track import Track

SPACING = 0.15  # m between the points that are moved
PASSES = 4
ROOM = 0.02  # m, at least, to either side
INSIDE = (np.inf, 0.7, 0.5, 0.3)  # of the centreline's radius, up to which the line may lie inside

Array = NDArray[np.float64]


def smooth_line(track: Track, margin: float) -> tuple[Array, Array]:
    """Return points (P + 1, 2) in m, the first again at the end, and where on the centreline they belong (P + 1,)."""
    count = max(12, round(track.length / SPACING))
    index = np.round(np.arange(count) * len(track.x) / count).astype(int)
    centre = np.stack([track.x[index], track.y[index]], axis=1)
    left = np.stack([-np.sin(track.yaw[index]), np.cos(track.yaw[index])], axis=1)
    low = -np.maximum(track.width_right[index] - margin, ROOM)
    high = np.maximum(track.width_left[index] - margin, ROOM)
    bend = track.curvature[index]
    lines = []
    for share in INSIDE:
        inside = np.maximum(share / np.maximum(np.abs(bend), 1e-9), ROOM)
        least, most = (
            np.where(bend < 0, np.maximum(low, -inside), low),
            np.where(bend > 0, np.minimum(high, inside), high),
        )
        lines.append(_straightest(centre, left, least, most))
    points = min(lines, key=_bending)
    s = np.append(index * track.spacing, track.length)
    return np.concatenate([points, points[:1]]), s


def _straightest(centre: Array, left: Array, low: Array, high: Array) -> Array:
    """Return the points (P, 2) whose offsets to the left of the centreline, within bounds, minimise ∫κ² ds."""
    count = len(centre)
    second = np.roll(np.eye(count), 1, axis=1) + np.roll(np.eye(count), -1, axis=1) - 2.0 * np.eye(count)
    points, lines = centre, []
    for _ in range(PASSES):
        along = np.roll(points, -1, axis=0) - np.roll(points, 1, axis=0)
        ds = np.hypot(*along.T) / 2
        # ∫κ² ds: the part of the second difference across the line, over ds^(3/2)
        across = np.stack([-along[:, 1], along[:, 0]], axis=1) / (2 * ds**2.5)[:, None]
        matrix = sum(across[:, axis, None] * second * left[:, axis] for axis in (0, 1))
        target = -(across * (second @ centre)).sum(axis=1)
        offset = lsq_linear(matrix, target, bounds=(low, high)).x
        points = centre + offset[:, None] * left
        lines.append(points)
    return min(lines, key=_bending)  # the next pass may go astray


def _bending(points: Array) -> float:
    """Return ∫κ² ds along a closed polygon: Σ Δθ²/ds."""
    chords = np.roll(points, -1, axis=0) - points
    lengths = np.hypot(*chords.T)
    yaw = np.arctan2(chords[:, 1], chords[:, 0])
    turn = np.mod(yaw - np.roll(yaw, 1) + np.pi, 2 * np.pi) - np.pi
    return float(np.sum(turn**2 / (lengths + np.roll(lengths, 1)) * 2))
