"""Fastest laps to hover over and to zoom into, on a page of its own that needs no network; drawn by Plotly."""

from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from racerl.errors import ConfigError
from racerl.report.figures.style import PALETTE
from racerl.report.flying_lap import FlyingLap, delta_time
from racerl.report.page import fill_in

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

PAGE = "interactive.html"
DIGITS = 4
MAP = (0.56, 1.0)  # of the page's height; the channels share what is below
BELOW = 0.06  # between the map and the channels
GAP = 0.015  # between two of them
CONFIG = {"responsive": True, "displaylogo": False, "modeBarButtonsToRemove": ["select2d", "lasso2d"]}
CHANNELS = ("speed [m/s]", "steering [rad]", "side slip [°]", "margin [m]", "behind [s]")


def require_plotly() -> None:
    """Raise ConfigError where Plotly is not installed."""
    if find_spec("plotly") is None:
        raise ConfigError("interactive = true needs plotly: in your clone, pip install -e '.[interactive]'")


def write_interactive(folder: Path, headline: str, laps: Sequence[FlyingLap], track: pd.DataFrame) -> Path:
    """Write the page of laps on a track, whose edges are `left_x_m` …, into a folder; return its path."""
    figure = draw(laps, track).to_html(full_html=False, include_plotlyjs=True, div_id="laps", config=CONFIG)
    colours = [[light, dark] for light, dark in PALETTE]
    return fill_in(folder / PAGE, "interactive_page.html.j2", headline=headline, figure=figure, colours=colours)


def draw(laps: Sequence[FlyingLap], track: pd.DataFrame) -> "Figure":
    """Return the figure: lines on the map, channels over the track coordinate below, and a mark for each car.

    Traces are, in order, two edges, and of each lap its line, its mark and the channels that any lap has; `meta` says
    which lap it is.
    """
    import plotly.graph_objects as go

    figure = go.Figure()
    world = {"xaxis": "x2", "yaxis": "y9"}
    seen = [channels(lap, laps[0]) for lap in laps]
    recorded = [name for name in CHANNELS if any(np.isfinite(rows[name]).any() for rows in seen)]
    for side in ("left", "right"):
        x, y = (_listed(np.append(edge, edge[:1])) for edge in track[[f"{side}_x_m", f"{side}_y_m"]].to_numpy().T)
        edge = {"color": "#808080", "width": 1}
        figure.add_scatter(x=x, y=y, mode="lines", line=edge, hoverinfo="skip", showlegend=False, **world)
    for number, lap in enumerate(laps):
        look = {"color": PALETTE[number][0], "width": 2}
        shared = {"name": lap.driver, "legendgroup": str(number), "meta": {"lap": number}}
        x, y, s = (_listed(lap.samples[name]) for name in ("x", "y", "s"))
        told = "%{customdata:.2f} m along the track"
        figure.add_scatter(x=x, y=y, customdata=s, mode="lines", line=look, hovertemplate=told, **world, **shared)
        mark = {"mode": "markers", "marker": {"size": 11, "color": look["color"]}, "hoverinfo": "skip"}
        figure.add_scatter(x=x[:1], y=y[:1], showlegend=False, **mark, **world, **shared)
        for row, channel in enumerate(recorded):
            axes = {"xaxis": "x", "yaxis": f"y{row + 1}" if row else "y"}
            figure.add_scatter(
                x=s, y=_listed(seen[number][channel]), line=look, mode="lines", showlegend=False, **axes, **shared
            )
    figure.update_layout(**_layout(recorded, laps[0].length))
    return figure


def channels(lap: FlyingLap, first: FlyingLap) -> dict[str, NDArray[np.floating]]:
    """Return what is drawn over the track coordinate, by the names of `CHANNELS`; NaN where it was not recorded."""
    samples = lap.samples
    unknown = pd.Series(np.nan, index=samples.index)
    rows = (
        samples["v_x"],
        samples["delta"],
        lap.side_slip(),
        samples.get("margin", unknown),
        delta_time(lap, first, samples["s"].to_numpy()),
    )
    return {name: np.asarray(row, float) for name, row in zip(CHANNELS, rows, strict=True)}


def _listed(values: ArrayLike) -> list[float]:
    """Return numbers as the page's script reads them: Plotly would pack an array."""
    return np.asarray(values, float).round(DIGITS).tolist()


def _layout(titles: Sequence[str], length: float) -> dict[str, Any]:
    """Return axes, one below the other, and what hovering shows: the same place in all of the channels."""
    highest = MAP[0] - BELOW
    tall = highest / len(titles)
    axes: dict[str, Mapping[str, Any]] = {}
    for row, title in enumerate(titles):
        top = highest - row * tall
        axes[f"yaxis{row + 1}" if row else "yaxis"] = {"domain": [top - tall + GAP, top], "title": {"text": title}}
    along = {
        "title": {"text": "along the track [m]"},
        "range": [0.0, length],
        "anchor": f"y{len(titles)}" if titles[1:] else "y",
    }
    spikes = {"showspikes": True, "spikemode": "across", "spikethickness": 1, "spikedash": "dot", "spikesnap": "cursor"}
    plain = {"showgrid": False, "zeroline": False}
    return {
        **axes,
        "xaxis": {**along, **spikes},
        "xaxis2": {"anchor": "y9", **plain, "title": {"text": "x [m]", "standoff": 5}},
        "yaxis9": {"anchor": "x2", "domain": MAP, "scaleanchor": "x2", **plain, "title": {"text": "y [m]"}},
        "hovermode": "x unified",
        "hoversubplots": "axis",
        "hoverlabel": {"namelength": -1},
        "template": "none",
        "modebar": {"bgcolor": "rgba(0,0,0,0)", "color": "#808080", "activecolor": "#808080"},
        "height": 1150,
        "margin": {"l": 60, "r": 10, "t": 60, "b": 45},
        "legend": {"orientation": "h", "y": 1.0, "yanchor": "bottom", "x": 0.0},
        "paper_bgcolor": "rgba(0,0,0,0)",
        "plot_bgcolor": "rgba(0,0,0,0)",
    }
