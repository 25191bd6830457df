"""The gap by channel: error before and after over what the sensors' noise alone leaves."""

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from racerl.report.figures.style import COLOURS, PAPER, WIDTH, style, to_svg


def draw(by_channel: Mapping[str, Mapping[str, float]], added: bool) -> str:
    """Return the SVG of one pair of bars per channel."""
    names = list(by_channel)
    before, after = (np.array([by_channel[n][k] / by_channel[n]["floor"] for n in names]) for k in ("before", "after"))
    place = np.arange(len(names))
    with style():
        figure = Figure(figsize=(WIDTH, 3.0))
        axis = figure.subplots()
        axis.bar(place - 0.2, before, 0.38, color=COLOURS[1], label="refitted model")
        if added:
            axis.bar(place + 0.2, after, 0.38, color=COLOURS[0], label="with the effects found")
        axis.axhline(1.0, color=PAPER, linewidth=1, linestyle=":", label="sensors' noise")
        axis.set(xticks=place, xticklabels=names, ylabel="error / noise", yscale="log")
        low, high = min(0.8, before.min(), after.min()), max(before.max(), after.max(), 1.5)
        axis.set_ylim(0.9 * low, 1.2 * high)
        axis.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
        axis.yaxis.set_minor_formatter(lambda value, _: f"{value:g}" if high < 8 else "")
        axis.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, fontsize=9)
        return to_svg(figure)
