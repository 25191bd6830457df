"""The gap by channel: error before and after over what the sensors' noise alone leaves."""

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from racerl.report.figures.style import COLOURS, PAPER, WIDTH, style, to_svg

TICKS = (
    0.6,
    0.7,
    0.8,
    0.9,
    1,
    1.1,
    1.2,
    1.3,
    1.4,
    1.6,
    1.8,
    2,
    2.5,
    3,
    4,
    6,
    8,
    10,
    15,
    20,
    30,
    40,
    60,
    80,
    100,
    200,
    400,
    1000,
)


def draw(by_channel: Mapping[str, Mapping[str, float]], added: bool) -> str:
    """Return the SVG of a dot before and one after for every channel, the first channel on top."""
    names = list(by_channel)[::-1]
    before, after = (np.array([by_channel[n][k] / by_channel[n]["floor"] for n in names]) for k in ("before", "after"))
    place = np.arange(len(names))
    with style():
        figure = Figure(figsize=(WIDTH, 1.1 + 0.32 * len(names)))
        axis = figure.subplots()
        if added:
            axis.hlines(place, before, after, color=PAPER, linewidth=1, alpha=0.6)
        axis.plot(before, place, "o", color=COLOURS[1], label="refitted model")
        if added:
            axis.plot(after, place, "o", color=COLOURS[0], label="with the effects found")
        axis.axvline(1.0, color=PAPER, linewidth=1, linestyle=":", label="sensors' noise")
        axis.set(yticks=place, yticklabels=names, xlabel="error / noise", xscale="log", ylim=(-0.6, len(names) - 0.4))
        low, high = min(0.9, before.min(), after.min()), max(before.max(), after.max(), 1.5)
        axis.set_xlim(0.95 * low, 1.1 * high)
        axis.set_xticks([tick for tick in TICKS if 0.95 * low <= tick <= 1.1 * high and (tick % 1 == 0 or high < 4.0)])
        axis.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
        axis.minorticks_off()
        axis.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, fontsize=9)
        return to_svg(figure)
