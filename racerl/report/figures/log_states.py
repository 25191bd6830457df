"""Where a log drives: its path, its accelerations, and slip angle over speed."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from racerl.report.figures.style import WIDTH, colour, style, to_svg

MOST = 6000  # points drawn
WINDOW = 9  # samples of the moving mean that quietens differences


def draw(table: pd.DataFrame, facts: Mapping[str, Any]) -> str | None:
    """Return the SVG, or None when the log has no velocities."""
    if not all(name in table for name in ("v_x", "v_y", "yaw_rate")):
        return None
    every = -(-len(table) // MOST)
    a_x, a_y = _accelerations(table, facts["rate_hz"])
    moving = table["v_x"].to_numpy() > 0.4
    panels = 3 if all(name in table for name in ("x", "y")) else 2
    with style():
        figure = Figure(figsize=(WIDTH, 3.2))
        axes = figure.subplots(1, panels)
        v_x, v_y = table["v_x"].to_numpy(), table["v_y"].to_numpy()
        _dots(axes[0], a_y[moving][::every], a_x[moving][::every], "a_y [m/s²]", "a_x [m/s²]")
        slip = np.arctan2(v_y, np.maximum(v_x, 0.4))
        _dots(axes[1], v_x[moving][::every], slip[moving][::every], "speed v_x [m/s]", "slip angle β [rad]")
        if panels == 3:
            for _, run in table.groupby("run", sort=False):
                axes[2].plot(run["x"][::every], run["y"][::every], color=colour(0), lw=0.7)
            axes[2].set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
        return to_svg(figure)


def _accelerations(table: pd.DataFrame, rate: float) -> tuple[np.ndarray, np.ndarray]:
    a_x, a_y = np.full(len(table), np.nan), np.full(len(table), np.nan)
    kernel = np.ones(WINDOW) / WINDOW
    for rows in table.groupby("run", sort=False).indices.values():
        if len(rows) < 2 * WINDOW:
            continue
        run = table.iloc[rows]
        v_x, v_y, r = (run[name].to_numpy() for name in ("v_x", "v_y", "yaw_rate"))
        inner = rows[WINDOW:-WINDOW]
        a_x[inner] = np.convolve(np.gradient(v_x) * rate - v_y * r, kernel, "same")[WINDOW:-WINDOW]
        a_y[inner] = np.convolve(np.gradient(v_y) * rate + v_x * r, kernel, "same")[WINDOW:-WINDOW]
    return a_x, a_y


def _dots(axis: Axes, x: np.ndarray, y: np.ndarray, xlabel: str, ylabel: str) -> None:
    axis.plot(x, y, ".", ms=1.5, alpha=0.35, color=colour(0), rasterized=True)
    axis.set(xlabel=xlabel, ylabel=ylabel)
