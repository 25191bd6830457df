"""A track as it is read: edges, the way round, metres along the lap, its map underneath, and places to look at."""

from collections.abc import Mapping

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.transforms import Affine2D
from numpy.typing import NDArray

from racerl.evaluate.outcome import track_table
from racerl.report.figures.edges import draw_edges, draw_line
from racerl.report.figures.style import INK, WARNING, WIDTH, colour, style, to_svg
from racerl.track.free_space import FreeSpace
from racerl.track.load import Given
from racerl.track.track import Track

MOST_CELLS = 700  # of a map, along its longer side
STEPS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)  # m between the places that are numbered
MOST_NUMBERS = 20
ARROWS = 5
LOOKS = (WARNING, colour(1), colour(3))


def draw(given: Given, marked: Mapping[str, NDArray[np.bool_]], title: str) -> str:
    """Return the SVG of a track with marks, by what they mean, where masks (M,) say."""
    track = given.track
    with style():
        figure = Figure(figsize=(WIDTH, _height(track)))
        axis = figure.subplots()
        axis.grid(visible=False)
        if given.free is not None:
            _draw_map(axis, given.free)
        table = track_table(track)
        draw_edges(axis, table)
        axis.plot([*track.x, track.x[0]], [*track.y, track.y[0]], color=colour(0), lw=0.8, label="centreline")
        for (what, mask), look in zip(marked.items(), LOOKS, strict=False):
            axis.plot(np.where(mask, track.x, np.nan), np.where(mask, track.y, np.nan), color=look, lw=3.0, label=what)
        draw_line(axis, table, label="start and finish")
        _draw_way(axis, track)
        _frame(axis, table)
        axis.set_title(f"{track.name}: {title}", fontsize=10)
        figure.legend(*axis.get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=8)
        return to_svg(figure)


def _height(track: Track) -> float:
    """Return a figure's height in inches for a track's proportions."""
    return float(np.clip(0.9 * WIDTH * np.ptp(track.y) / max(np.ptp(track.x), 1e-9) + 1.2, 4.0, 12.0))


def _draw_way(axis: Axes, track: Track) -> None:
    """Draw arrows along the lap, and its metres outside the left edge."""
    for index in (np.arange(ARROWS) + 0.5) * len(track.x) / ARROWS:
        i = int(index)
        size = 0.3 * track.max_half_width
        dx, dy = size * np.cos(track.yaw[i]), size * np.sin(track.yaw[i])
        axis.annotate(
            "",
            (track.x[i] + dx, track.y[i] + dy),
            (track.x[i] - dx, track.y[i] - dy),
            arrowprops={"color": INK, "arrowstyle": "-|>"},
        )
    step = next((step for step in STEPS if track.length / step <= MOST_NUMBERS), STEPS[-1])
    left_x, left_y = track.boundary(1)
    for metres in np.arange(0, track.length - 0.3 * step, step):
        i = int(metres / track.spacing)
        axis.annotate(
            f"{metres:g}",
            (left_x[i], left_y[i]),
            (-9 * np.sin(track.yaw[i]), 9 * np.cos(track.yaw[i])),
            textcoords="offset points",
            fontsize=7,
            ha="center",
            va="center",
        )


def _draw_map(axis: Axes, free: FreeSpace) -> None:
    """Draw what the map has as occupied, in blocks of cells where there are many."""
    block = -(-max(free.free.shape) // MOST_CELLS)
    rows, columns = (-(-size // block) for size in free.free.shape)
    whole = np.ones((rows * block, columns * block), dtype=bool)
    whole[: free.free.shape[0], : free.free.shape[1]] = free.free
    cells = whole.reshape(rows, block, columns, block).all(axis=(1, 3))
    image = axis.imshow(
        np.where(cells, 1.0, 0.8),
        cmap="gray",
        vmin=0.0,
        vmax=1.0,
        origin="lower",
        interpolation="nearest",
        extent=(0.0, columns * block * free.resolution, 0.0, rows * block * free.resolution),
    )
    image.set_transform(Affine2D().rotate(free.turned).translate(*free.origin[:2]) + axis.transData)


def _frame(axis: Axes, table: pd.DataFrame) -> None:
    """Show the track and a little around it."""
    for name, limit in (("x", axis.set_xlim), ("y", axis.set_ylim)):
        both = np.concatenate([table[f"left_{name}_m"], table[f"right_{name}_m"]])
        rim = 0.04 * np.ptp(both) + 0.3
        limit(both.min() - rim, both.max() + rim)
    axis.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
