"""The paper's Fig. 4: reward over training steps, mean and range over seeds; the paper's curves beside them."""

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from numpy.typing import NDArray

from racerl.paper import figure_4
from racerl.report.figures.style import WIDTH, colour, style, to_svg

Array = NDArray[np.float64]
POINTS = 200


def draw(learning: pd.DataFrame) -> str | None:
    """Return the SVG from rows of sweep, arm, seed, steps and reward; None without any."""
    curves: dict[str, tuple[Array, Array]] = {}
    for (_, arm), rows in learning.groupby(["sweep", "arm"], sort=False):
        band = _band(rows)
        # arms that were trained alike are one curve
        same = next((name for name, curve in curves.items() if np.array_equal(curve[1], band[1])), None)
        curves[f"{same}, {arm}" if same else str(arm)] = curves.pop(same) if same else band
    if not curves:
        return None
    with style():
        figure = Figure(figsize=(WIDTH, 3.8))
        ours, theirs = figure.subplots(1, 2)
        for i, (arm, (steps, rewards)) in enumerate(curves.items()):
            label = f"{arm.replace('_', ' ')} ({len(rewards)} seed{'s' * (len(rewards) > 1)})"
            ours.plot(steps / 1e6, np.mean(rewards, axis=0), color=colour(i), lw=1.4, label=label)
            low, high = np.min(rewards, axis=0), np.max(rewards, axis=0)
            ours.fill_between(steps / 1e6, low, high, color=colour(i), alpha=0.2, lw=0)
        for i, (name, rows) in enumerate(figure_4().groupby("curve")):
            theirs.plot(
                rows["million_steps"], rows["reward"], color=colour(i), lw=1.2, label=str(name).replace("_", " ")
            )
        ours.set(xlabel="control steps [million]", ylabel="reward per step", title="here: mean and range")
        theirs.set(xlabel="control steps [million]", title="paper (its levels have another scale)")
        for axis in (ours, theirs):
            axis.set_ylim(bottom=0.0)
            axis.legend(loc="lower right", fontsize=8)
        return to_svg(figure)


def _band(rows: pd.DataFrame) -> tuple[Array, Array]:
    """Return steps (K,) that all trainings of an arm have, and their rewards there (S, K)."""
    each = [one for _, one in rows.groupby("seed")]
    first, last = max(one["steps"].min() for one in each), min(one["steps"].max() for one in each)
    steps = np.linspace(float(first), float(last), POINTS)
    return steps, np.array([np.interp(steps, one["steps"], one["reward"]) for one in each])
