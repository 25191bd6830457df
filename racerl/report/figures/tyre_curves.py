"""Tyre force over load against slip, both axles, with the 95 % band of the identified coefficients."""

from collections.abc import Mapping, Sequence

import pandas as pd
from matplotlib.figure import Figure

from racerl.report.figures.style import COLOURS, PAPER, WIDTH, style, to_svg

SLIPS = {"x": ("kappa", "slip ratio κ", "F_x / F_z"), "y": ("alpha", "tan of the slip angle α", "F_y / F_z")}


def draw(curves: pd.DataFrame, covered: Mapping[str, Sequence[float]], fitted: bool) -> str:
    """Return the SVG; `covered` says which slips the log reached, by name and axle's initial."""
    with style():
        figure = Figure(figsize=(WIDTH, 6.2))
        axes = figure.subplots(2, 2, sharey=True)
        for row, axle in enumerate(("front", "rear")):
            for column, direction in enumerate(("x", "y")):
                axis = axes[row, column]
                name, label, force = SLIPS[direction]
                low, high = covered[f"{name}_{axle[0]}"]
                axis.axvspan(low, high, color=PAPER, alpha=0.15, lw=0, label="slips in the log (1 … 99 %)")
                curve = curves[(curves["axle"] == axle) & (curves["direction"] == direction)]
                if fitted:
                    axis.fill_between(curve["slip"], curve["low"], curve["high"], color=COLOURS[0], alpha=0.3, lw=0)
                    axis.plot(curve["slip"], curve["start"], color=COLOURS[1], lw=1.0, ls="--", label="before")
                axis.plot(
                    curve["slip"],
                    curve["value"],
                    color=COLOURS[0],
                    lw=1.5,
                    label="identified, 95 % band" if fitted else "given vehicle",
                )
                axis.set(
                    xlabel=label,
                    ylabel=f"{axle} {force}",
                    xlim=(float(curve["slip"].min()), float(curve["slip"].max())),
                )
        figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper left", ncols=3, fontsize=9)
        return to_svg(figure)
