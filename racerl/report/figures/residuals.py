"""Histograms of the errors at the end of the rollouts, channel by channel."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from racerl.report.figures.overlay import LABELS
from racerl.report.figures.style import COLOURS, WIDTH, style, to_svg


def draw(residuals: Mapping[str, Mapping[str, Any]], fitted: bool) -> str:
    """Return the SVG of one panel per channel; `residuals` holds edges and counts by vehicle and channel."""
    channels = list(residuals["fitted"])
    with style():
        figure = Figure(figsize=(WIDTH, 2.9))
        axes = figure.subplots(1, len(channels), sharey=True, squeeze=False).ravel()
        for axis, channel in zip(axes, channels, strict=True):
            shown = [("fitted", "identified" if fitted else "simulated", COLOURS[0])]
            if fitted:
                shown.insert(0, ("unfitted", "before", COLOURS[1]))
            widest = 0.0
            for key, label, colour in shown:
                edges, counts = (np.array(residuals[key][channel][name]) for name in ("edges", "counts"))
                share = counts / max(counts.sum(), 1)
                axis.stairs(share, edges, color=colour, fill=key == "fitted", alpha=0.7, label=label)
                # 99 % of the errors are in sight
                common = np.flatnonzero((np.cumsum(share) > 0.005) & (np.cumsum(share[::-1])[::-1] > 0.005))
                widest = max(widest, *np.abs(edges[common]), *np.abs(edges[common + 1]), 0.0)
            axis.set(xlabel=LABELS[channel], xlim=(-1.1 * widest, 1.1 * widest) if widest else None)
        axes[0].set_ylabel("share of rollouts")
        axes[0].legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, fontsize=9)
        return to_svg(figure)
