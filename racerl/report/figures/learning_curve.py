"""Learning: mean reward per step and evaluation lap over training steps."""

from collections.abc import Sequence

import pandas as pd
from matplotlib.figure import Figure

from racerl.report.figures.style import WIDTH, colour, style, to_svg
from racerl.report.subjects import Subject

PANELS = (  # column of the log, title, axis, how it is drawn
    ("train/reward", "Training reward", "reward per step [m]", "-"),
    ("evaluation/mean_lap_s", "Evaluation on the way, mean lap", "lap time [s]", "o-"),
)


def draw(subjects: Sequence[Subject]) -> str | None:
    """Return the SVG, a panel for each column that was logged; None when there is none."""
    panels = [(*panel, found) for panel in PANELS if (found := _curves(subjects, panel[0]))]
    if not panels:
        return None
    with style():
        figure = Figure(figsize=(WIDTH, 3.4))
        axes = figure.subplots(1, len(panels), squeeze=False).ravel()
        for axis, (_, title, ylabel, look, curves) in zip(axes, panels, strict=True):
            for i, label, steps, values in curves:
                axis.plot(steps / 1e6, values, look, ms=3, color=colour(i), lw=1.2, label=label)
            axis.set(xlabel="control steps [million]", ylabel=ylabel, title=title)
        axes[0].legend(loc="lower right", fontsize=8)
        return to_svg(figure)


def _curves(subjects: Sequence[Subject], column: str) -> list[tuple[int, str, pd.Series, pd.Series]]:
    """Return number, title, steps and values of the subjects whose training has logged a column."""
    logged = [
        (i, s.title, s.progress) for i, s in enumerate(subjects) if s.progress is not None and column in s.progress
    ]
    known = [(i, title, log[log[column].notna()]) for i, title, log in logged]
    return [(i, title, log["steps"], log[column]) for i, title, log in known if len(log)]
