"""The paper's Fig. 6 for any two drivers: lines with marks at equal times, speed, delta time and steering along s.

Below them what the paper does not show: side slip, and the margin to the nearer edge.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from racerl.report.figures.edges import draw_edges, draw_line
from racerl.report.figures.style import COLOURS, PAPER, WIDTH, style, to_svg
from racerl.report.flying_lap import FlyingLap, delta_time

MARKS = 25  # at most, on a lap
PLACES = 501  # along s
LOOKS: Sequence[dict[str, Any]] = (  # of A, B and the paper's two laps
    {"color": COLOURS[0], "lw": 1.6},
    {"color": COLOURS[1], "lw": 1.6},
    {"color": PAPER, "lw": 1.0, "ls": ":"},
    {"color": PAPER, "lw": 1.0, "ls": "--"},
)


def draw(
    a: FlyingLap,
    b: FlyingLap,
    track: pd.DataFrame,
    paper: Sequence[FlyingLap] = (),
    colours: Sequence[str] = COLOURS[:2],
) -> str:
    """Return the SVG of two laps on a track (the table of an evaluation), with the paper's two if they are given."""
    looks = [look | {"color": own} for look, own in zip(LOOKS, colours, strict=False)] + list(LOOKS[2:])
    with style():
        tall = float(np.clip(8.0 * np.ptp(track["y_m"]) / np.ptp(track["x_m"]), 3.0, 6.2))  # in, of the first panel
        figure = Figure(figsize=(WIDTH, 10.5 + tall))
        grid = figure.add_gridspec(6, 1, height_ratios=[tall, 2.1, 2.1, 2.1, 2.1, 2.1])
        _draw_lines(figure.add_subplot(grid[0]), a, b, track, looks)
        speed = figure.add_subplot(grid[1])
        delta, steering, slip, margin = (figure.add_subplot(grid[row], sharex=speed) for row in (2, 3, 4, 5))
        for lap, look in zip((a, b, *paper), looks, strict=False):
            speed.plot(lap.samples["s"], lap.samples["v_x"], label=lap.driver, **look)
            steering.plot(lap.samples["s"], lap.samples["delta"], **look)
            if "v_y" in lap.samples:
                slip.plot(lap.samples["s"], lap.side_slip(), **look)
            if "margin" in lap.samples:
                margin.plot(lap.samples["s"], lap.samples["margin"], **look)
        for axis in (slip, margin):
            axis.axhline(0.0, color="black", lw=0.6)
        _draw_delta_time(delta, a, b, paper)
        speed.set(ylabel="(b) v_x [m/s]", xlim=(0.0, a.length))
        steering.set(ylabel="(d) steering δ [rad]")
        slip.set(ylabel="(e) side slip β [°]")
        margin.set(ylabel="(f) margin to the\nnearer edge [m]", xlabel="s along the centreline [m]")
        for axis in (speed, delta, steering, slip):
            axis.tick_params(labelbottom=False)
        figure.align_ylabels([speed, delta, steering, slip, margin])
        figure.legend(*speed.get_legend_handles_labels(), loc="outside upper left", ncols=1, fontsize=9)
        return to_svg(figure)


def _draw_lines(axis: Axes, a: FlyingLap, b: FlyingLap, track: pd.DataFrame, looks: Sequence[dict[str, Any]]) -> None:
    draw_edges(axis, track)
    draw_line(axis, track)
    every = 0.5 * np.ceil(2.0 * max(a.time_s, b.time_s) / MARKS)  # s
    times = every * np.arange(1, MARKS + 1)
    for lap, look in zip((a, b), looks, strict=False):
        axis.plot(lap.samples["x"], lap.samples["y"], **look)
        places = lap.marks(times)
        axis.plot(*places[::2].T, "o", ms=4, color=look["color"], zorder=3)
        axis.plot(*places[1::2].T, "o", ms=11, color=look["color"], zorder=3)
        for time, (x, y) in zip(times[1::2], places[1::2], strict=False):
            axis.text(x, y, f"{time:g}", color="white", size=7, ha="center", va="center_baseline", zorder=3)
    axis.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    axis.set_title(f"(a) marks every {every:g} s, numbers in s since the thick line", fontsize=10)


def _draw_delta_time(axis: Axes, a: FlyingLap, b: FlyingLap, paper: Sequence[FlyingLap]) -> None:
    s = np.linspace(0.0, a.length, PLACES)
    axis.axhline(0.0, color="black", lw=0.6)
    axis.plot(s, delta_time(a, b, s), color="black", lw=1.6, label="A − B")
    if paper:
        rl, human = paper
        axis.plot(s, delta_time(rl, human, s), label="the paper's: RL − human", **LOOKS[2])
        axis.legend(fontsize=8)
    axis.set_ylabel("(c) delta time [s]\nbelow 0: A is ahead")
