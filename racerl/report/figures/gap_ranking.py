"""What each candidate of the first round takes away of the excess on held-out windows."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from racerl.report.figures.style import COLOURS, PAPER, WIDTH, style, to_svg


def draw(ranking: Sequence[dict[str, Any]]) -> str | None:
    """Return the SVG of one bar per candidate, best on top; None without candidates."""
    if not ranking:
        return None
    rows = list(reversed(ranking))
    shares = np.clip([row["explained"] for row in rows], -1.0, 1.0) * 100
    with style():
        figure = Figure(figsize=(WIDTH, 0.9 + 0.35 * len(rows)))
        axis = figure.subplots()
        colours = [COLOURS[0] if row is ranking[0] else PAPER for row in rows]
        axis.barh(np.arange(len(rows)), shares, 0.6, color=colours)
        axis.axvline(0.0, color=PAPER, linewidth=1)
        axis.set(yticks=np.arange(len(rows)), yticklabels=[row["name"] for row in rows])
        axis.set_xlabel("excess error explained in held-out windows / %")
        axis.set_xlim(min(0.0, float(shares.min())) * 1.05, 105.0)
        return to_svg(figure)
