"""Coverage: how long a log dwells where; accelerations against each other, and a histogram of every state."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from racerl.report.figures.style import WIDTH, colour, style, to_svg

LABELS = {
    "speed": "speed v_x [m/s]",
    "slip_angle": "slip angle β [rad]",
    "slip_ratio": "slip ratio (ω − v_x)/v_x",
    "a_x": "a_x [m/s²]",
    "a_y": "a_y [m/s²]",
}


def draw(facts: Mapping[str, Any]) -> str | None:
    """Return the SVG, or None when the log shows none of the states."""
    coverage = {name: facts["coverage"][name] for name in LABELS if name in facts["coverage"]}
    if not coverage:
        return None
    columns = 3
    rows = -(-len(coverage) // columns)
    with style():
        figure = Figure(figsize=(WIDTH, 2.3 * rows))
        axes = figure.subplots(rows, columns, squeeze=False).ravel()
        for axis, (name, content) in zip(axes, coverage.items(), strict=False):
            _histogram(axis, name, content)
        for axis in axes[len(coverage) :]:
            axis.set_visible(False)
        for axis in axes[::columns]:
            axis.set_ylabel("time [s]")
        return to_svg(figure)


def _histogram(axis: Axes, name: str, content: Mapping[str, Any]) -> None:
    edges, seconds = np.array(content["edges"]), np.array(content["seconds"])
    axis.bar(edges[:-1], seconds, width=np.diff(edges), align="edge", color=colour(0), alpha=0.85)
    median = content["percentiles"]["50"]
    axis.axvline(median, color=colour(1), lw=1.2)
    axis.set(xlabel=LABELS[name], xlim=(edges[0], edges[-1]))
    axis.locator_params(axis="x", nbins=5)
