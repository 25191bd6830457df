"""Tracks from files.

CSV centreline (F1TENTH, TUM)   x_m, y_m, w_tr_right_m, w_tr_left_m: the right width comes first. `#` starts a comment;
                                comma, semicolon or blanks separate.
ROS map set                     `map.yaml` (image, resolution, origin, …), its image, and a centreline CSV beside it
                                (`*centerline*.csv` or `*centreline*.csv`). The widths are checked against the image.
"""

import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from racerl.documents import inside, read_text, read_yaml, require_content
from racerl.errors import DocumentError, TrackError, suggest
from racerl.track.track import Array, Track, build_track

log = logging.getLogger(__name__)

IMAGE_SUFFIXES = (".png", ".pgm", ".bmp", ".jpg", ".jpeg")
MAX_PIXELS = 100_000_000
MAP_KEYS = ("image", "resolution", "origin", "negate", "occupied_thresh")  # that are read
SWAP_EVIDENCE = 0.05  # m of mean misfit by which swapped widths must fit better


def load_track(settings: dict[str, Any], folder: Path) -> Track:
    """Load the track whose `file` the settings name, looked for here and then in `folder`.

    Further settings go before a map's own; a centreline has none.
    """
    if "file" not in settings:
        raise TrackError("track: has no 'file'; give a centreline .csv or a map .yaml")
    path = Path(str(settings["file"]))
    try:
        path = path if path.exists() else folder / path
    except (OSError, ValueError) as error:  # too long to be a path, or with a zero byte in it
        raise TrackError(f"track {str(path)[:80]!r}: cannot be a file ({error.__class__.__name__})") from error
    return read_track(path, {k: v for k, v in settings.items() if k != "file"})


def read_track(path: Path, changes: Mapping[str, Any] | None = None) -> Track:
    """Read a centreline CSV or a ROS map yaml, with some of the map's settings changed; TrackError or DocumentError."""
    if not path.is_file():
        raise TrackError(f"track {path}: no such file; give a centreline .csv or a map .yaml")
    changes = changes or {}
    if path.suffix.lower() in (".yaml", ".yml"):
        return _read_map(path, changes)
    if changes:
        raise TrackError(f"track.{next(iter(changes))}: a centreline has no settings, only a map .yaml has")
    points, width_right, width_left = _read_centreline(path)
    return build_track(path.stem, points, width_right, width_left)


def _read_centreline(path: Path) -> tuple[Array, Array, Array]:
    rows = []
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        fields = line.split("#", 1)[0].replace(",", " ").replace(";", " ").split()
        if not fields:
            continue
        try:
            rows.append([float(field) for field in fields])
        except ValueError as error:
            if not rows:
                continue  # a header without '#'
            raise TrackError(f"track {path}: line {number} is not numeric ({error})") from error
        if len(rows[-1]) != len(rows[0]):
            raise TrackError(f"track {path}: line {number} has {len(rows[-1])} columns, the first {len(rows[0])}")
    if not rows:
        raise TrackError(f"track {path}: holds no points; columns are x_m, y_m, w_tr_right_m, w_tr_left_m")
    if len(rows[0]) != 4:
        raise TrackError(f"track {path}: {len(rows[0])} columns, 4 are read: x_m, y_m, w_tr_right_m, w_tr_left_m")
    table = np.array(rows)
    return table[:, :2], table[:, 2], table[:, 3]


def _read_map(path: Path, changes: Mapping[str, Any]) -> Track:
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
    points, width_right, width_left = _read_centreline((own or centrelines)[0])
    track = build_track(path.stem, points, width_right, width_left)
    free = _FreeSpace(path, settings)
    return _checked_against(free, track, lambda: build_track(path.stem, points, width_left, width_right))


def _checked_against(free: "_FreeSpace", track: Track, swapped: Any) -> Track:
    """Return the track, with its widths swapped (and a warning) when only that agrees with the image."""
    blocked = 1.0 - float(free.at(track.x, track.y).mean())
    if blocked > 0.1:
        raise TrackError(
            f"track {track.name}: {blocked:.0%} of the centreline lies on occupied or unknown cells of {free.image}; "
            "check resolution, origin and negate"
        )
    right, left = free.reach(track, -1), free.reach(track, 1)
    as_given = np.mean(np.abs(right - track.width_right) + np.abs(left - track.width_left))
    other_way = np.mean(np.abs(right - track.width_left) + np.abs(left - track.width_right))
    if other_way + SWAP_EVIDENCE < as_given:
        log.warning(
            "track %s: widths fit the image %.2f m better with left before right; swapped",
            track.name,
            as_given - other_way,
        )
        return swapped()
    return track


class _FreeSpace:
    """The drivable cells of a ROS occupancy image, in world coordinates."""

    def __init__(self, path: Path, settings: dict[str, Any]) -> None:
        try:
            self.resolution = float(settings["resolution"])
            self.origin = [float(value) for value in settings["origin"]]
            negate = bool(int(settings.get("negate", 0)))
            occupied = float(settings.get("occupied_thresh", 0.65))
        except (KeyError, TypeError, ValueError) as error:
            raise TrackError(f"track {path}: {error!s} is missing or not a number; a ROS map yaml has it") from error
        if self.resolution <= 0 or len(self.origin) < 2:
            raise TrackError(f"track {path}: resolution {self.resolution:g} and origin {self.origin} make no map")
        self.image = _find_image(path, str(settings.get("image", "")))
        grey = _read_image(self.image) / 255.0
        # ROS: occupancy p = (255 − x)/255, negated p = x/255
        self._free = ((grey if negate else 1.0 - grey) < occupied)[::-1]

    def at(self, x: Array, y: Array) -> NDArray[np.bool_]:
        """Return whether points are inside the image and free."""
        turn = -self.origin[2] if len(self.origin) > 2 else 0.0
        dx, dy = x - self.origin[0], y - self.origin[1]
        column = np.floor((dx * np.cos(turn) - dy * np.sin(turn)) / self.resolution).astype(int)
        row = np.floor((dx * np.sin(turn) + dy * np.cos(turn)) / self.resolution).astype(int)
        rows, columns = self._free.shape
        known = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
        return known & self._free[np.clip(row, 0, rows - 1), np.clip(column, 0, columns - 1)]

    def reach(self, track: Track, side: int) -> Array:
        """Return the free distance from the centreline to the left (1) or right (−1), in m, (M,)."""
        limit = 1.5 * max(track.width_left.max(), track.width_right.max())
        steps = np.arange(0.0, limit, self.resolution / 2)
        x = track.x[:, None] - side * steps * np.sin(track.yaw)[:, None]
        y = track.y[:, None] + side * steps * np.cos(track.yaw)[:, None]
        return np.logical_and.accumulate(self.at(x, y), axis=1).sum(axis=1) * self.resolution / 2


def _find_image(path: Path, name: str) -> Path:
    """Return the image that the yaml names; when it is absent, the one beside the yaml, with a warning."""
    try:
        named = inside(path.parent, name)
    except DocumentError as error:
        raise TrackError(f"track {path}: image {error}") from error
    try:
        if name and named.is_file():
            return named
    except OSError as error:  # too long to be a name
        raise TrackError(f"track {path}: image {name[:80]!r}: cannot be a file ({error.strerror})") from error
    beside = sorted(file for file in path.parent.iterdir() if file.suffix.lower() in IMAGE_SUFFIXES)
    own = [file for file in beside if file.stem == path.stem] or beside
    if len(own) != 1:
        found = ", ".join(file.name for file in beside) or "none"
        raise TrackError(f"track {path}: image '{name}' is not there (images beside it: {found}); mend the yaml")
    log.warning("track %s: image '%s' is not there; using %s", path, name, own[0].name)
    return own[0]


def _read_image(path: Path) -> Array:
    Image.MAX_IMAGE_PIXELS = MAX_PIXELS
    try:
        require_content(path)
        with Image.open(path) as image:
            return np.asarray(image.convert("L"), dtype=np.float64)
    except (
        OSError,
        DocumentError,
        UnidentifiedImageError,
        Image.DecompressionBombError,
        ValueError,
        SyntaxError,
    ) as error:
        raise TrackError(f"track: image {path} cannot be read ({' '.join(str(error).split())})") from error
