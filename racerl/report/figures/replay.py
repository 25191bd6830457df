"""Laps as a moving picture: cars on the track, behind each its last second and a half, coloured by side slip."""

import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.animation import AbstractMovieWriter, FFMpegWriter, PillowWriter
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray

from racerl.errors import ConfigError, RunError
from racerl.report.figures.edges import draw_edges, draw_line
from racerl.report.figures.style import INK, PAPER, colour, style
from racerl.report.flying_lap import FlyingLap

Array = NDArray[np.floating]
CAR = (0.5, 0.28)  # m, length and width as drawn
TRAIL = 1.5  # s
SLIDES = 40.0  # degrees of side slip, where the colours end
RATES = {".gif": 12.5, ".mp4": 30.0}  # pictures a second; a GIF's stand for whole hundredths of a second
SIZE, DOTS = 8.0, 80  # in, at most, and dots per inch
SHADES = mpl.colormaps["viridis"].with_extremes(bad=PAPER)  # of side slip; where it was not recorded
MOST = 300  # pictures: a long lap has fewer a second
CORNERS = np.array([(0.5, 0.0), (0.3, 0.5), (-0.5, 0.5), (-0.5, -0.5), (0.3, -0.5)])  # of a car, in its size


def writer(file: str) -> AbstractMovieWriter:
    """Return what writes such a file; raise ConfigError for another kind, or where ffmpeg is missing."""
    kind = Path(file).suffix
    if kind not in RATES or Path(file).name != file:
        raise ConfigError(f"file = {file}: a name that ends with {' or '.join(RATES)} is expected")
    if kind == ".gif":
        return PillowWriter(fps=RATES[kind])  # type: ignore[arg-type]
    if not FFMpegWriter.isAvailable():
        raise ConfigError(f"file = {file}: needs ffmpeg, which is not here; choose file=laps.gif")
    return FFMpegWriter(fps=RATES[kind])  # type: ignore[arg-type]


def draw(laps: Sequence[FlyingLap], track: pd.DataFrame, moving: AbstractMovieWriter) -> bytes:
    """Return the content of the picture's file; all cars pass the line at its beginning."""
    with style():
        figure = _stage(track)
        axis = figure.axes[0]
        scale = Normalize(0.0, SLIDES)
        trails = [LineCollection([], cmap=SHADES, norm=scale, linewidths=2.0) for _ in laps]
        for trail in trails:
            axis.add_collection(trail)
        cars = [axis.fill([], [], facecolor=colour(i), edgecolor=INK, lw=0.8, zorder=3)[0] for i in range(len(laps))]
        figure.legend(cars, [lap.driver for lap in laps], loc="outside lower left", fontsize=9)
        clock = axis.set_title("0.00 s", fontsize=10, loc="right")
        figure.colorbar(trails[0], ax=axis, label="side slip [°]", shrink=0.6)
        figure.draw_without_rendering()  # lays out, once for all pictures
        figure.set_layout_engine("none")
        end = max(lap.time_s for lap in laps)
        moving.fps = min(moving.fps, max(1, int(MOST / end)))
        drives = [_columns(lap) for lap in laps]
        with tempfile.TemporaryDirectory(prefix="racerl-show-") as folder:
            path = Path(folder) / f"laps{'.gif' if isinstance(moving, PillowWriter) else '.mp4'}"
            try:
                with moving.saving(figure, str(path), DOTS):
                    for t in np.arange(0.0, end, 1.0 / moving.fps):
                        for lap, drive, trail, car in zip(laps, drives, trails, cars, strict=True):
                            _place(drive, min(float(t), lap.time_s), trail, car)
                        clock.set_text(f"{t:.2f} s")
                        moving.grab_frame()
            except (OSError, subprocess.CalledProcessError) as error:
                raise RunError(f"{path.name}: could not be written ({error}); choose file=laps.gif") from error
            return path.read_bytes()


def heading(lap: FlyingLap) -> Array:
    """Return where the car points in rad, unwrapped; by the way that it goes where the heading was not recorded."""
    if "yaw" in lap.samples:
        return np.unwrap(lap.samples["yaw"])
    course = np.arctan2(np.gradient(lap.samples["y"]), np.gradient(lap.samples["x"]))
    return np.unwrap(course) - np.radians(np.nan_to_num(lap.side_slip()))


def _stage(track: pd.DataFrame) -> Figure:
    """Return a figure of the empty track."""
    wide, tall = (float(np.ptp(track[[f"left_{a}_m", f"right_{a}_m"]])) for a in ("x", "y"))
    across = SIZE if wide >= tall else SIZE * max(wide / tall, 0.5) + 1.5
    figure = Figure(figsize=(across, min(SIZE, across * tall / wide) + 0.8))
    FigureCanvasAgg(figure)
    axis = figure.add_subplot()
    draw_edges(axis, track)
    draw_line(axis, track)
    axis.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    return figure


def _columns(lap: FlyingLap) -> Array:
    """Return t, x, y, side slip without its sign, and heading of a lap, (5, T)."""
    samples = lap.samples
    columns = (samples["t"], samples["x"], samples["y"], np.abs(lap.side_slip()), heading(lap))
    return np.stack([np.asarray(column, float) for column in columns])


def _place(drive: Array, t: float, trail: LineCollection, car: Any) -> None:
    """Move a car and what it leaves behind to a time in s since the line."""
    t = min(t, drive[0, -1])
    times = np.linspace(max(t - TRAIL, drive[0, 0]), t, 40)
    x, y, slip, yaw = (np.interp(times, drive[0], column) for column in drive[1:])
    points = np.stack([x, y], axis=1)
    trail.set_segments(list(np.stack([points[:-1], points[1:]], axis=1)))
    trail.set_array(slip[1:])
    turn = np.array([[np.cos(yaw[-1]), np.sin(yaw[-1])], [-np.sin(yaw[-1]), np.cos(yaw[-1])]])
    car.set_xy(CORNERS * CAR @ turn + points[-1])
