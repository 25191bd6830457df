"""Two laps on the track, coloured by speed, with the car's heading: where it leaves the line, the car slides."""

from collections.abc import Sequence
from textwrap import fill

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from racerl.report.figures.edges import draw_edges, draw_line
from racerl.report.figures.style import INK, WIDTH, style, to_svg
from racerl.report.flying_lap import FlyingLap

EVERY = 0.2  # s between headings
BAR = 0.5  # m, about as long as a car
TITLE = 48  # characters of a line


def draw(laps: Sequence[FlyingLap], track: pd.DataFrame) -> str:
    """Return the SVG of two laps side by side on a track (the table of an evaluation), on one scale of speed."""
    speeds = np.concatenate([lap.samples["v_x"].to_numpy() for lap in laps])
    with style():
        high = 0.42 * WIDTH * float(np.ptp(track["y_m"]) / np.ptp(track["x_m"]))
        figure = Figure(figsize=(WIDTH, float(np.clip(high, 2.5, 7.0)) + 1.2))
        axes = figure.subplots(1, len(laps), sharey=True)
        for axis, lap in zip(axes, laps, strict=True):
            draw_edges(axis, track)
            line = _coloured(axis, lap, (float(speeds.min()), float(speeds.max())))
            slip = _headings(axis, lap)
            draw_line(axis, track)
            axis.set_title(f"{fill(lap.driver, TITLE)}{slip}", fontsize=9)
            axis.set(xlabel="x [m]", aspect="equal")
        axes[0].set_ylabel("y [m]")
        figure.colorbar(line, ax=list(axes), label="v_x [m/s]", shrink=0.7)
        return to_svg(figure)


def _coloured(axis: Axes, lap: FlyingLap, limits: tuple[float, float]) -> LineCollection:
    """Draw a lap's line, coloured by speed between two limits in m/s."""
    points = lap.samples[["x", "y"]].to_numpy()
    line = LineCollection(list(np.stack([points[:-1], points[1:]], axis=1)), cmap="viridis", linewidths=3.0)
    line.set_array(lap.samples["v_x"].to_numpy()[:-1])
    line.set_clim(*limits)
    axis.add_collection(line)
    return line


def _headings(axis: Axes, lap: FlyingLap) -> str:
    """Draw where the car heads at equal times, if that was recorded; return what to say of its side slip."""
    samples = lap.samples
    if not {"yaw", "v_y"} <= set(samples):
        return ""
    times = np.arange(0.0, lap.time_s, EVERY)
    columns = samples["x"], samples["y"], np.unwrap(samples["yaw"])
    x, y, yaw = (np.interp(times, samples["t"], column) for column in columns)
    ends = 0.5 * BAR * np.array([[-1.0], [1.0]])  # tail and nose, (2, 1)
    bars = x + ends * np.cos(yaw), y + ends * np.sin(yaw)
    axis.plot(*bars, color=INK, lw=1.2)
    axis.plot(*(places[1] for places in bars), "o", color=INK, ms=2.5)
    slip = np.abs(lap.side_slip()[samples["t"].between(0.0, lap.time_s)]).max()
    return f"\nside slip up to {slip:.0f}°, heading every {EVERY:g} s"
