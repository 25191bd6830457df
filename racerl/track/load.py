"""Tracks from files.

CSV centreline   as in `racerl.track.centreline`.
ROS map set      `map.yaml` (image, resolution, origin, …), its image, and a centreline CSV beside it
                 (`*centerline*.csv` or `*centreline*.csv`). The widths are checked against the image.
"""

import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from racerl.documents import read_yaml
from racerl.errors import TrackError, suggest
from racerl.track.centreline import Centreline, read_centreline
from racerl.track.free_space import FreeSpace
from racerl.track.track import Track

log = logging.getLogger(__name__)

MAP_KEYS = ("image", "resolution", "origin", "negate", "occupied_thresh", "free_thresh")  # that are read
SWAP_EVIDENCE = 0.05  # m of mean misfit by which swapped widths must fit better


class Given(NamedTuple):
    """What the files of a track hold."""

    centreline: Centreline
    track: Track
    free: FreeSpace | None  # where there is a map

    def reversed(self) -> "Given":
        """Return the track as it is driven the other way round."""
        centreline = self.centreline.reversed()
        return Given(centreline, centreline.build(self.track.name), self.free)


def load_track(settings: dict[str, Any], folder: Path) -> Track:
    """Load the track whose `file` the settings name, looked for here and then in `folder`.

    Further settings go before a map's own; a centreline has none.
    """
    return load_given(settings, folder).track


def load_given(settings: Mapping[str, Any], folder: Path, scale: float = 1.0) -> Given:
    """Load what the files of that track hold; `scale` makes metres of the centreline's unit."""
    if "file" not in settings:
        raise TrackError("track: has no 'file'; give a centreline .csv or a map .yaml")
    path = Path(str(settings["file"]))
    try:
        path = path if path.exists() else folder / path
    except (OSError, ValueError) as error:  # too long to be a path, or with a zero byte in it
        raise TrackError(f"track {str(path)[:80]!r}: cannot be a file ({error.__class__.__name__})") from error
    return read_given(path, {k: v for k, v in settings.items() if k != "file"}, scale)


def read_track(path: Path, changes: Mapping[str, Any] | None = None) -> Track:
    """Read a centreline CSV or a ROS map yaml, with some of the map's settings changed; TrackError or DocumentError."""
    return read_given(path, changes).track


def read_given(path: Path, changes: Mapping[str, Any] | None = None, scale: float = 1.0) -> Given:
    """Read what the files of such a track hold; `scale` makes metres of the centreline's unit."""
    if not path.is_file():
        raise TrackError(f"track {path}: no such file; give a centreline .csv or a map .yaml")
    changes = changes or {}
    if path.suffix.lower() in (".yaml", ".yml"):
        return _read_map(path, changes, scale)
    if changes:
        raise TrackError(f"track.{next(iter(changes))}: a centreline has no settings, only a map .yaml has")
    centreline = read_centreline(path).scaled(scale)
    return Given(centreline, centreline.build(path.stem), None)


def _read_map(path: Path, changes: Mapping[str, Any], scale: float) -> Given:
    settings = read_yaml(path)
    for key in changes:
        if key not in MAP_KEYS:
            raise TrackError(f"track {path}: a map has no '{key}'{suggest(key, MAP_KEYS)}")
    settings |= changes
    centrelines = sorted({*path.parent.glob("*centerline*.csv"), *path.parent.glob("*centreline*.csv")})
    own = [file for file in centrelines if file.stem.startswith(path.stem.removesuffix("_map"))]
    if not centrelines:
        raise TrackError(f"track {path}: no *centerline*.csv beside it; a map needs a centreline with widths")
    if len(own or centrelines) > 1:
        names = ", ".join(file.name for file in own or centrelines)
        raise TrackError(f"track {path}: several centrelines ({names}); give the CSV itself as the track")
    centreline = read_centreline((own or centrelines)[0]).scaled(scale)
    track, free = centreline.build(path.stem), FreeSpace(path, settings)
    if _fits_swapped(free, track):
        centreline = centreline.swapped()
        track = centreline.build(path.stem)
    return Given(centreline, track, free)


def _fits_swapped(free: FreeSpace, track: Track) -> bool:
    """Return whether only swapped widths agree with the image (and warn); raise TrackError where the line does not."""
    blocked = 1.0 - float(free.at(track.x, track.y).mean())
    if blocked > 0.1:
        raise TrackError(
            f"track {track.name}: {blocked:.0%} of the centreline lies on occupied or unknown cells of {free.image}; "
            "check resolution, origin and negate, and whether the line is in m"
        )
    right, left = free.reach(track, -1), free.reach(track, 1)
    as_given = np.mean(np.abs(right - track.width_right) + np.abs(left - track.width_left))
    other_way = np.mean(np.abs(right - track.width_left) + np.abs(left - track.width_right))
    if other_way + SWAP_EVIDENCE >= as_given:
        return False
    log.warning(
        "track %s: widths fit the image %.2f m better with left before right; swapped",
        track.name,
        as_given - other_way,
    )
    return True
