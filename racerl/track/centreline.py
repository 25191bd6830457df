"""A centreline as a CSV has it (F1TENTH, TUM): x_m, y_m, w_tr_right_m, w_tr_left_m.

The right width comes first. `#` starts a comment; comma, semicolon or blanks separate.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from racerl.documents import read_text
from racerl.errors import TrackError
from racerl.track.track import Array, Track, build_track

HEADER = "# x_m,y_m,w_tr_right_m,w_tr_left_m"


class Centreline(NamedTuple):
    """The points of a closed line as a file has them, in m, and the distance to either edge."""

    points: Array  # (P, 2)
    width_right: Array  # (P,)
    width_left: Array  # (P,)

    def scaled(self, factor: float) -> "Centreline":
        """Return it with all lengths multiplied."""
        return Centreline(*(factor * table for table in self))

    def reversed(self) -> "Centreline":
        """Return it as it is driven the other way round."""
        return Centreline(self.points[::-1], self.width_left[::-1], self.width_right[::-1])

    def swapped(self) -> "Centreline":
        """Return it with right for left."""
        return Centreline(self.points, self.width_left, self.width_right)

    def build(self, name: str) -> Track:
        """Return the track of that name."""
        return build_track(name, *self)

    def text(self) -> str:
        """Return it as CSV, to a tenth of a millimetre."""
        rows = np.column_stack([self.points, self.width_right, self.width_left])
        return "\n".join([HEADER, *(",".join(f"{value:.4f}" for value in row) for row in rows)]) + "\n"


def cells(text: str) -> list[str]:
    """Return what commas, semicolons or blanks separate."""
    return text.replace(",", " ").replace(";", " ").split()


def read_centreline(path: Path) -> Centreline:
    """Read a centreline CSV; raise TrackError or DocumentError."""
    rows = []
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        fields = cells(line.split("#", 1)[0])
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
    return Centreline(table[:, :2], table[:, 2], table[:, 3])
