"""One look for all figures, and SVGs that are byte-identical when drawn twice."""

import io
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

WIDTH = 9.0  # inches, page width
COLOURS = ("#0b6e99", "#d1495b", "#2e933c", "#edae49", "#6a4c93", "#66717e")
PAPER = "#444444"
SETTINGS: dict[Any, Any] = {
    "svg.hashsalt": "racerl",
    "svg.fonttype": "path",
    "font.size": 10,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "figure.constrained_layout.use": True,
}


@contextmanager
def style() -> Iterator[None]:
    """Use the report's settings while drawing."""
    with mpl.rc_context(SETTINGS):
        yield


def colour(index: int) -> str:
    """Return the colour of the index-th subject."""
    return COLOURS[index % len(COLOURS)]


def to_svg(figure: Figure) -> str:
    """Return the figure as SVG text without a date."""
    stream = io.StringIO()
    with style():
        FigureCanvasSVG(figure)  # becomes the figure's own
        figure.set_dpi(72)  # as SVG has it
        figure.draw_without_rendering()  # lays out
        figure.set_layout_engine("none")
        for axis in figure.axes:  # the layout's last digit, which names are hashed from, varies from time to time
            axis.set_position(np.round(axis.get_position(original=True).bounds, 6).tolist())
        figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": "racerl"})
    return stream.getvalue()
