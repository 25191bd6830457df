"""The racing line: the fastest lap over the track, coloured by speed, with the paper's line beside it."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from racerl.paper import figure_6
from racerl.report.figures.edges import draw_edges, draw_line
from racerl.report.figures.style import PAPER, WIDTH, style, to_svg
from racerl.report.subjects import Evaluation, Subject

MOST = 4  # panels


def draw(subjects: Sequence[Subject]) -> str | None:
    """Return the SVG, or None when nobody finished a lap."""
    raced = [s for s in subjects if s.evaluation is not None and len(s.evaluation.fastest_lap())][:MOST]
    if not raced:
        return None
    columns = 1 if len(raced) == 1 else 2
    rows = -(-len(raced) // columns)
    with style():
        figure = Figure(figsize=(WIDTH if columns > 1 else 0.62 * WIDTH, 6.0 * rows))
        axes = figure.subplots(rows, columns, squeeze=False).ravel()
        speeds = np.concatenate([s.evaluation.fastest_lap()["v_x"].to_numpy() for s in raced if s.evaluation])
        limits = (float(speeds.min()), float(speeds.max()))
        for axis, subject in zip(axes, raced, strict=False):
            assert subject.evaluation is not None  # noqa: S101
            lines = _panel(axis, subject.evaluation, limits)
            axis.set_title(subject.title, fontsize=10)
        for axis in axes[len(raced) :]:
            axis.set_visible(False)
        figure.colorbar(lines, ax=list(axes[: len(raced)]), label="v_x [m/s]", shrink=0.8)
        figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=8)
        return to_svg(figure)


def _panel(axis: Axes, evaluation: Evaluation, limits: tuple[float, float]) -> LineCollection:
    track, lap = evaluation.track, evaluation.fastest_lap(beyond=1)
    draw_edges(axis, track)
    axis.plot(track["x_m"], track["y_m"], color="grey", lw=0.6, ls=(0, (6, 6)), label="centreline")
    if evaluation.metrics.get("track") == "l_shape":
        paper = figure_6("lines")
        axis.plot(paper["x_m"], paper["y_m"], color=PAPER, lw=1.0, ls=":", label="paper, RL on the real car")
    points = lap[["x", "y"]].to_numpy()
    segments = np.stack([points[:-1], points[1:]], axis=1)
    lines = LineCollection(list(segments), cmap="viridis", norm=None, linewidths=2.5)
    lines.set_array(lap["v_x"].to_numpy()[:-1])
    lines.set_clim(*limits)
    axis.add_collection(lines)
    draw_line(axis, track, label="start and finish")
    axis.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    return lines
