"""The gap along the driven path, before and after."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from racerl.report.figures.style import WIDTH, style, to_svg

LEAST = 4.0  # times the noise, up to which the colours reach at least


def draw(path: Sequence[Mapping[str, Any]], added: bool) -> str:
    """Return the SVG of every window's path, coloured by its error over the noise, the worst on top."""
    titles = {"before": "refitted model", **({"after": "with the effects found"} if added else {})}
    points = np.concatenate([np.array([row["x"], row["y"]]).T for row in path])
    width, height = np.maximum(np.ptp(points, axis=0), 0.5)
    worst = max(LEAST, float(np.quantile([row["before"] for row in path], 0.99)))
    with style():
        panel = 0.44 * WIDTH
        figure = Figure(figsize=(WIDTH if added else 0.6 * WIDTH, 0.8 + min(max(panel * height / width, 2.2), 5.5)))
        axes = figure.subplots(1, len(titles), squeeze=False, sharex=True, sharey=True).ravel()
        for axis, (key, title) in zip(axes, titles.items(), strict=True):
            lines = _panel(axis, path, key, LogNorm(1.0, worst, clip=True))
            axis.set(title=title, xlabel="x [m]", aspect="equal")
            axis.autoscale_view()
        axes[0].set_ylabel("y [m]")
        bar = figure.colorbar(lines, ax=list(axes), label="error / noise", extend="both", shrink=0.9)
        ticks = [tick for tick in (1, 2, 3, 5, 10, 20, 30, 50, 100, 200, 500) if tick <= worst]
        bar.set_ticks(ticks, labels=[f"{tick}" for tick in ticks])
        bar.minorticks_off()
        return to_svg(figure)


def _panel(axis: Axes, path: Sequence[Mapping[str, Any]], key: str, norm: LogNorm) -> LineCollection:
    rows = sorted(path, key=lambda row: row[key])
    lines = LineCollection(
        [np.array([row["x"], row["y"]]).T for row in rows], cmap="cividis", norm=norm, linewidths=1.8
    )
    lines.set_array(np.array([row[key] for row in rows]))
    axis.add_collection(lines)
    return lines
