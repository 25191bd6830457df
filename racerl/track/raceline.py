"""Racelines in the TUM format, both ways: semicolons, three header rows, columns s, x, y, psi, kappa, vx, ax.

psi is the heading of the path, 0 along +y and positive to the left; the last row repeats the first, a lap further on.
Read is what has these columns in this order, or names its columns in a header (x_m, y_m and vx_mps at least); commas
or blanks may separate, `#` begins a comment, header rows may lack it.
"""

from pathlib import Path

import numpy as np
import pandas as pd
from scipy.interpolate import CubicSpline

from racerl.documents import read_text, require_content
from racerl.errors import DocumentError, TrackError
from racerl.track.centreline import cells

COLUMNS = ("s_m", "x_m", "y_m", "psi_rad", "kappa_radpm", "vx_mps", "ax_mps2")
NEEDED = ("x_m", "y_m", "vx_mps")
SAME = 1e-6  # m within which the last point is the first
FEWEST = 10  # points
SHORTEST = 1.0  # m
HEAD = 64 * 1024  # bytes that are looked at to tell a raceline


def raceline_text(line: pd.DataFrame, length: float, about: tuple[str, str]) -> str:
    """Return a closed line of COLUMNS, without a repeated point, as such a file; `about` it are two header rows."""
    again = line.iloc[:1].assign(s_m=line["s_m"].iloc[0] + length)
    closed = pd.concat([line, again])[list(COLUMNS)]
    rows = closed.to_csv(index=False, header=False, sep=";", float_format="%.7f", lineterminator="\n")
    head = [*(" ".join(each.split()) for each in about), "; ".join(COLUMNS)]
    return "".join(f"# {row}\n" for row in head) + rows.replace(";", "; ")


def read_raceline(path: Path) -> pd.DataFrame:
    """Return those of COLUMNS that a raceline has, a row per point, the first not repeated; TrackError otherwise."""
    names, rows = _parse(read_text(path))
    names = names or (list(COLUMNS) if rows and len(rows[0]) == len(COLUMNS) else [])
    if not set(NEEDED) <= {*names} or len({*names}) < len(names):
        raise TrackError(f"{path}: no TUM raceline ({'; '.join(COLUMNS)}); a header may name its columns so")
    try:
        table = pd.DataFrame(np.array([[float(cell) for cell in row] for row in rows]), columns=names)
    except ValueError as error:
        raise TrackError(f"{path}: no TUM raceline ({len(names)} numbers in each row are expected): {error}") from error
    line = table[[name for name in COLUMNS if name in names]]
    x, y = line["x_m"].to_numpy(), line["y_m"].to_numpy()
    ways = np.hypot(np.roll(x, -1) - x, np.roll(y, -1) - y)  # to the next point, the last one's to the first
    line, length = line[~(ways <= SAME)], ways[:-1].sum()
    if len(line) < FEWEST or not np.isfinite(line).all(axis=None) or (line["vx_mps"] <= 0).any() or length < SHORTEST:
        raise TrackError(
            f"{path}: {FEWEST} points or more with positive speeds over {SHORTEST:g} m are expected of a raceline"
        )
    return line


def is_raceline(path: Path) -> bool:
    """Return whether a file looks like a raceline, rather than a drive log."""
    try:
        require_content(path)
        with path.open("rb") as stream:
            text = stream.read(HEAD).decode(errors="replace")
    except (DocumentError, OSError):
        return False
    names, _ = _parse(text)
    first = next((row for line in text.splitlines() if (row := line.partition("#")[0].strip())), "")
    unnamed = ";" in first and _numeric(cells(first)) == len(COLUMNS)
    return {*NEEDED} <= {*names} or unnamed


def drive_along(line: pd.DataFrame, laps: float, rate: float) -> pd.DataFrame:
    """Return the drive along a raceline at its speeds, sampled at a rate in Hz: t in s, x, y, yaw of the path, v_x."""
    x, y, speed = (np.append(line[name], line[name].iloc[0]) for name in NEEDED)
    ways = np.hypot(np.diff(x), np.diff(y))
    times = np.concatenate([[0.0], np.cumsum(2 * ways / (speed[1:] + speed[:-1]))])
    t = np.arange(0.0, laps * times[-1], 1 / rate)
    path = CubicSpline(times, np.column_stack([x, y]), bc_type="periodic")
    dx, dy = path(np.mod(t, times[-1]), 1).T
    at = {"x": x, "y": y, "v_x": speed}
    columns = {name: np.interp(np.mod(t, times[-1]), times, values) for name, values in at.items()}
    return pd.DataFrame({"t": t, "run": 0, **columns, "yaw": np.unwrap(np.arctan2(dy, dx))})


def _parse(text: str) -> tuple[list[str], list[list[str]]]:
    """Return the columns that a header names, none where it does not, and the cells of the rows below."""
    names: list[str] = []
    rows: list[list[str]] = []
    for line in text.splitlines():
        content, _, comment = line.partition("#")
        row = cells(content)
        header = cells(comment.partition("#")[0]) if not row else row if not rows and not _numeric(row) else []
        if set(NEEDED) <= {*header}:
            names = header
        elif row and (rows or _numeric(row)):
            rows.append(row)
    return names, rows


def _numeric(row: list[str]) -> int:
    """Return how many cells there are where all are numbers, else 0."""
    try:
        return len([float(cell) for cell in row])
    except ValueError:
        return 0
