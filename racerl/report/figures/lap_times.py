"""Lap times: every finished lap as a point, quartiles as a box, the paper's means beside them."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from racerl.paper import NAMES, table_1
from racerl.report.figures.style import PAPER, WARNING, WIDTH, colour, style, to_svg
from racerl.report.subjects import Subject


def draw(subjects: Sequence[Subject]) -> str | None:
    """Return the SVG, or None when nobody finished a lap."""
    laps = []
    for i, subject in enumerate(subjects):
        rows = subject.evaluation.metrics["rows"] if subject.evaluation else []
        times = [(row["time_s"], row["valid"]) for row in rows if row["time_s"] is not None]
        if times:
            laps.append((i, subject.title, times))
    if not laps:
        return None
    paper = table_1()
    labels = [label for _, label, _ in laps] + [NAMES[name] for name in paper["name"]]
    with style():
        figure = Figure(figsize=(WIDTH, 0.8 + 0.42 * len(labels)))
        axis = figure.subplots()
        for row, (i, _, times) in enumerate(laps):
            values = np.array([time for time, _ in times])
            valid = np.array([ok for _, ok in times])
            jitter = row + 0.22 * np.linspace(-1, 1, len(values))
            axis.boxplot(
                values,
                positions=[row],
                orientation="horizontal",
                widths=0.6,
                showfliers=False,
                manage_ticks=False,
                medianprops={"color": "black"},
            )
            axis.plot(values[valid], jitter[valid], "o", ms=3, color=colour(i))
            axis.plot(values[~valid], jitter[~valid], "x", ms=4, color=WARNING)
        for row, (mean, std) in enumerate(zip(paper["mean_lap_s"], paper["std_lap_s"], strict=True), start=len(laps)):
            axis.errorbar(mean, row, xerr=std, fmt="D", ms=4, color=PAPER, capsize=3)
        axis.set_yticks(range(len(labels)), labels)
        axis.invert_yaxis()
        axis.set(xlabel="lap time [s]   (● valid, × left the track; paper: mean ± std on the real car)")
        return to_svg(figure)
