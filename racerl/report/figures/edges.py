"""The track under a figure: its edges, and the line that laps begin at."""

from typing import Any

import pandas as pd
from matplotlib.axes import Axes

from racerl.report.figures.style import INK


def draw_edges(axis: Axes, track: pd.DataFrame) -> None:
    """Draw both edges of a track (the table of an evaluation), closed."""
    for side in ("left", "right"):
        x, y = track[f"{side}_x_m"], track[f"{side}_y_m"]
        axis.plot([*x, x.iloc[0]], [*y, y.iloc[0]], color="black", lw=1.0)


def draw_line(axis: Axes, track: pd.DataFrame, **look: Any) -> None:
    """Draw the line at the beginning of a track."""
    start = track.iloc[0]
    x, y = ([start[f"left_{name}_m"], start[f"right_{name}_m"]] for name in ("x", "y"))
    axis.plot(x, y, color=INK, lw=3.0, **look)
