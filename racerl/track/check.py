"""What is odd about a track: its unit, bends that the car cannot take, ground that it shares, walls inside its widths.

A *problem* makes a track no track for this car; a *warning* says what to look at. Places are told in m along the lap.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from racerl.track.free_space import FreeSpace
from racerl.track.load import Given
from racerl.track.track import Array, Track

CAR = 0.3  # m, the width of a 1:10 car
WIDEST = 8.0  # m, mean width that a track for such cars may have
BEND = 0.5  # rad that a track may turn more tightly than the car can along its outer edge: a kink, no corner
SHALLOW = 0.02  # m that edges may reach into another stretch
STRETCHES = 1500  # pieces that the line is cut into where each is set against each
CELLS = 2.0  # of the image that widths may reach beyond its free space
LEAST_SHARE = 0.01  # of the lap

Mask = NDArray[np.bool_]
UNITS = "cm take scale=0.01, pixels scale=RESOLUTION, a full-size track scale=0.1"


@dataclass
class Findings:
    """What was found; the masks (M,), by what they mark, say where."""

    problems: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    marked: dict[str, Mask] = field(default_factory=dict)


def describe(track: Track) -> dict[str, Any]:
    """Return a track's numbers."""
    width = track.width_left + track.width_right
    turned = float(track.curvature.sum() * track.spacing)
    return {
        "track": track.name,
        "length_m": round(track.length, 3),
        "width_m": [round(float(width.min()), 3), round(float(width.max()), 3)],
        "narrowest_at_m": _at(track, int(width.argmin())),
        "radius_m": round(1.0 / track.max_curvature, 3),
        "radius_at_m": _at(track, int(np.abs(track.curvature).argmax())),
        "direction": "counter-clockwise" if turned > np.pi else "clockwise" if turned < -np.pi else "figure of eight",
    }


def check(given: Given, turning_radius: float) -> Findings:
    """Return what is odd about a track for a car that turns on a radius in m, or wider."""
    found, track = Findings(), given.track
    _check_unit(given, found)
    if found.problems:  # all else would be told in a wrong unit
        return found
    _check_bends(track, turning_radius, found)
    _check_crossings(track, found)
    _check_ground(track, found)
    if given.free is not None:
        _check_walls(track, given.free, found)
    return found


def _check_unit(given: Given, found: Findings) -> None:
    width = given.track.width_left + given.track.width_right
    mean, narrowest = float(width.mean()), float(width.min())
    if mean > WIDEST or mean < CAR:
        found.problems.append(
            f"is {mean:.3g} m wide on average, {CAR:g} … {WIDEST:g} m suit a 1:10 car; if it is not in m: {UNITS}"
        )
    elif narrowest < CAR:
        at = _at(given.track, int(width.argmin()))
        found.warnings.append(f"{narrowest:.2f} m wide at s = {at:g} m; a 1:10 car is {CAR:g} m wide")
    points = given.centreline.points
    if np.array_equal(points, np.round(points)):
        found.warnings.append("all coordinates are whole numbers, as pixels are; if so, give scale=RESOLUTION (m)")


def _check_bends(track: Track, turning_radius: float, found: Findings) -> None:
    curvature = np.abs(track.curvature)
    tight = curvature > 1.0 / turning_radius
    if not tight.any():
        return
    found.marked["tighter than this car turns"] = tight
    outside = np.where(track.curvature > 0, track.width_right, track.width_left)
    hopeless = curvature * (turning_radius - outside) > 1.0  # 1/|κ| + width < radius
    kinked = (curvature * hopeless).sum() * track.spacing > BEND
    worst = int((curvature * hopeless if kinked else curvature).argmax())
    told = f"turns on a radius of {1 / curvature[worst]:.2f} m at s = {_at(track, worst):g} m, "
    if kinked:
        outer = 1 / curvature[worst] + outside[worst]
        told += f"{outer:.2f} m along its outer edge, this car on {turning_radius:.2f} m or more; widen it there"
        found.problems.append(told)
    else:
        found.warnings.append(told + f"this car on {turning_radius:.2f} m or more: it cannot keep to the centreline")


def _check_crossings(track: Track, found: Findings) -> None:
    index = _some(track)
    a = np.stack([track.x[index], track.y[index]], axis=1)
    b = np.roll(a, -1, axis=0)
    one_side = _side(a[:, None], b[:, None], a[None]) * _side(a[:, None], b[:, None], b[None]) < 0
    crossing = np.argwhere(np.triu(one_side & one_side.T, k=2))
    if len(crossing):
        first, second = (_at(track, int(index[i])) for i in crossing[0])
        found.problems.append(
            f"crosses itself at s = {first:g} m and s = {second:g} m; look for points out of order, or a bridge"
        )


def _side(a: Array, b: Array, point: Array) -> Array:
    """Return on which side of lines from a to b points lie: positive to the left."""
    along, off = b - a, point - a
    side: Array = along[..., 0] * off[..., 1] - along[..., 1] * off[..., 0]
    return side


def _check_ground(track: Track, found: Findings) -> None:
    """Warn where an edge of one stretch lies inside another, which is no neighbour along the lap."""
    index = _some(track)
    line = cKDTree(np.stack([track.x, track.y], axis=1)[index])
    s, shared = index * track.spacing, np.full(len(index), -1)
    for side in (1, -1):
        edge = np.stack(track.boundary(side), axis=1)[index]
        near = index[line.query(edge)[1]]
        dx, dy = edge[:, 0] - track.x[near], edge[:, 1] - track.y[near]
        n = dy * np.cos(track.yaw[near]) - dx * np.sin(track.yaw[near])
        inside = np.abs(n) < np.where(n > 0, track.width_left[near], track.width_right[near]) - SHALLOW
        apart = np.abs(np.mod(near * track.spacing - s + track.length / 2, track.length) - track.length / 2)
        other = inside & (apart > np.pi * track.max_half_width)  # more than round a bend as tight as the track is wide
        shared = np.where(other, near, shared)
    if (mask := shared >= 0).any():
        first = int(mask.argmax())
        found.marked["shared ground"] = mask[np.arange(len(track.x)) * len(index) // len(track.x)]
        found.warnings.append(
            f"widths overlap: an edge at s = {_at(track, int(index[first])):g} m lies inside the track at "
            f"s = {_at(track, int(shared[first])):g} m; cars drive through what parts them"
        )


def _check_walls(track: Track, free: FreeSpace, found: Findings) -> None:
    walls = np.zeros(len(track.x), dtype=bool)
    for side, name, width in ((-1, "right", track.width_right), (1, "left", track.width_left)):
        beyond = width - free.reach(track, side)
        behind = beyond > CELLS * free.resolution
        if behind.mean() > LEAST_SHARE:
            worst = int(beyond.argmax())
            found.warnings.append(
                f"its {name} edge lies up to {beyond[worst]:.2f} m (s = {_at(track, worst):g} m) behind what "
                f"{free.image.name} has as occupied or unknown, over {behind.mean():.0%} of the lap; lower its widths"
            )
            walls |= behind
    if walls.any():
        found.marked["a wall inside the widths"] = walls


def _some(track: Track) -> NDArray[np.intp]:
    """Return at most STRETCHES entries of the track's tables, evenly."""
    count = min(len(track.x), STRETCHES)
    return (np.arange(count) * len(track.x) // count).astype(np.intp)


def _at(track: Track, index: int) -> float:
    return round(index * track.spacing, 1)
