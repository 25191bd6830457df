"""Command against response of each actuator, where the command had settled."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from racerl.report.figures.style import COLOURS, PAPER, WIDTH, style, to_svg


def draw(actuators: Mapping[str, Mapping[str, Any]], units: Mapping[str, str]) -> str | None:
    """Return the SVG of one panel per actuator; None where none was logged with its command."""
    if not actuators:
        return None
    with style():
        figure = Figure(figsize=(WIDTH, 3.6))
        axes = figure.subplots(1, 2, squeeze=False).ravel()
        for axis, (name, row) in zip(axes, actuators.items(), strict=False):
            (asked, shown), command = row["channels"], row["command"]
            axis.plot(command, row["response"], ".", color=COLOURS[0], markersize=4, alpha=0.5)
            axis.set(xlabel=f"{asked} [{units[asked]}]", ylabel=f"{shown} [{units[shown]}]")
            if row["scale"] is None:
                _one_command(axis, name, row, units[shown])
                continue
            ends = [min(command), max(command)]
            axis.plot(ends, ends, color=PAPER, linewidth=1, linestyle=":")
            sign = "−" if row["offset"] < 0.0 else "+"
            line = f"{row['scale']:.3f} × command {sign} {abs(row['offset']):.3f} {units[shown]}"
            axis.plot(ends, [row["scale"] * end + row["offset"] for end in ends], color=COLOURS[1], label=line)
            behind = "" if row["lag"] is None else f", {row['lag']:.2f} s behind"
            axis.set_title(f"{name}{behind}", fontsize=10)
            axis.legend(loc="upper left", fontsize=9)
        for axis in axes[len(actuators) :]:
            axis.set_visible(False)
        return to_svg(figure)


def _one_command(axis: Axes, name: str, row: Mapping[str, Any], unit: str) -> None:
    """Show a command that never changed as a point on the line of what was asked for, beside what was measured."""
    asked, reached = row["command"][0], float(np.median(row["response"]))
    axis.plot([asked], [asked], "_", color=COLOURS[1], markersize=14, label=f"always commanded: {asked:.3g} {unit}")
    axis.set_title(f"{name}: reached {reached:.3g} {unit}", fontsize=10)
    axis.legend(loc="best", fontsize=9)
