"""One look for all figures, and SVGs that are byte-identical when drawn twice."""

import io
from collections.abc import Hashable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

WIDTH = 9.0  # inches, page width
# on white and on a dark page; none is red, and the first seven are apart for protanopes and deuteranopes too
PALETTE = (
    ("#0072b2", "#4ba3dc"),  # blue
    ("#d98200", "#f0a63a"),  # orange
    ("#00835f", "#35c79a"),  # green
    ("#4a2fd6", "#7465ff"),  # violet
    ("#38b2c4", "#9ceaff"),  # cyan
    ("#14146e", "#94709c"),  # navy
    ("#b0a058", "#9c6a18"),  # sand
    ("#b0528f", "#f0b4dc"),  # mauve
    ("#1f5c2e", "#4f8f5c"),  # dark green
    ("#14808c", "#4cc0cc"),  # teal
    ("#2c3a58", "#8ca0cc"),  # ink blue
    ("#7a5230", "#b98f66"),  # brown
    ("#7fc08a", "#a8f0b4"),  # light green
    ("#5f6b76", "#a5b1bc"),  # slate
    ("#8f8f8f", "#8a8a8a"),  # grey
)
COLOURS = tuple(light for light, _ in PALETTE)
PAPER = "#444444"
INK = "#000000"
WARNING = "#b0232f"  # crashes and other mishaps alone
SETTINGS: dict[Any, Any] = {
    "svg.hashsalt": "racerl",
    "text.parse_math": False,  # a dollar in a file's name is one
    "svg.fonttype": "none",  # text stays text
    "font.sans-serif": ["DejaVu Sans", "Verdana", "Arial"],  # the first is laid out with, the others are as wide
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


def assign(identities: Mapping[Any, Hashable]) -> dict[Any, str]:
    """Return a colour for each key, the same for keys of one identity; a page hands it to all its figures."""
    order = list(dict.fromkeys(identities.values()))
    return {key: colour(order.index(identity)) for key, identity in identities.items()}


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
