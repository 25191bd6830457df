"""Where the image of a ROS map (`map.yaml`: image, resolution, origin, …) says that a car can drive."""

import logging
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from racerl.documents import inside, require_content
from racerl.errors import DocumentError, TrackError
from racerl.track.track import Array, Track

log = logging.getLogger(__name__)

IMAGE_SUFFIXES = (".png", ".pgm", ".bmp", ".jpg", ".jpeg")
MAX_PIXELS = 100_000_000
UNKNOWN = 205  # what ROS writes for cells that nobody has seen, with thresholds between which it may not lie


class FreeSpace:
    """The drivable cells of a ROS occupancy image, in world coordinates."""

    def __init__(self, path: Path, settings: dict[str, Any]) -> None:
        try:
            self.resolution = float(settings["resolution"])
            self.origin = [float(value) for value in settings["origin"]]
            negate = bool(int(settings.get("negate", 0)))
            occupied = float(settings.get("occupied_thresh", 0.65))
            free = float(settings.get("free_thresh", 0.196))
        except (KeyError, TypeError, ValueError) as error:
            raise TrackError(f"track {path}: {error!s} is missing or not a number; a ROS map yaml has it") from error
        if self.resolution <= 0 or len(self.origin) < 2:
            raise TrackError(f"track {path}: resolution {self.resolution:g} and origin {self.origin} make no map")
        self.image = _find_image(path, str(settings.get("image", "")))
        image = _read_image(self.image)
        grey = image / 255.0
        # ROS: occupancy p = (255 − x)/255, negated p = x/255; between the thresholds a cell is unknown
        self.free = (((grey if negate else 1.0 - grey) < min(free, occupied)) & (image != UNKNOWN))[::-1]

    @property
    def turned(self) -> float:
        """How far the image is turned about its origin, in rad."""
        return self.origin[2] if len(self.origin) > 2 else 0.0

    def at(self, x: Array, y: Array) -> NDArray[np.bool_]:
        """Return whether points are inside the image and free."""
        turn = -self.turned
        dx, dy = x - self.origin[0], y - self.origin[1]
        column = np.floor((dx * np.cos(turn) - dy * np.sin(turn)) / self.resolution).astype(int)
        row = np.floor((dx * np.sin(turn) + dy * np.cos(turn)) / self.resolution).astype(int)
        rows, columns = self.free.shape
        known = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
        return known & self.free[np.clip(row, 0, rows - 1), np.clip(column, 0, columns - 1)]

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
