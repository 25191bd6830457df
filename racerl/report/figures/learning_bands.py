"""The paper's Fig. 4: reward over training steps, mean and range over seeds; the paper's curves beside them."""

from collections.abc import Mapping

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from numpy.typing import NDArray

from racerl.paper import figure_4
from racerl.report.figures.style import PAPER, WIDTH, style, to_svg

Array = NDArray[np.float64]
POINTS = 200
ARMS = {  # of the paper's curves
    "geometric_speed_rate": ("geometric", "speed_rate"),
    "progress_speed_rate": ("progress",),
    "geometric_speed": ("speed",),
}
DASHES = ("-", "--", ":")  # of curves whose arm was not trained here


def draw(learning: pd.DataFrame, colours: Mapping[tuple[str, str], str]) -> str | None:
    """Return the SVG from rows of sweep, arm, seed, steps and reward; None without any.

    `colours` has every arm's by sweep and name; arms that were trained alike share it, and are one curve.
    """
    names: dict[str, list[str]] = {}
    curves: dict[str, tuple[Array, Array]] = {}
    for (sweep, arm), rows in learning.groupby(["sweep", "arm"], sort=False):
        if rows["steps"].nunique() < 2:
            continue  # one update is no curve
        names.setdefault(colours[sweep, arm], []).append(str(arm))
        curves[colours[sweep, arm]] = _band(rows)
    if not curves:
        return None
    with style():
        figure = Figure(figsize=(WIDTH, 3.8))
        ours, theirs = figure.subplots(1, 2)
        for colour, (steps, rewards) in curves.items():
            arms = ", ".join(names[colour]).replace("_", " ")
            label = f"{arms} ({len(rewards)} seed{'s' * (len(rewards) > 1)})"
            ours.plot(steps / 1e6, np.mean(rewards, axis=0), color=colour, lw=1.4, label=label)
            low, high = np.min(rewards, axis=0), np.max(rewards, axis=0)
            ours.fill_between(steps / 1e6, low, high, color=colour, alpha=0.2, lw=0)
        own = {arm: colour for colour, arms in names.items() for arm in arms}
        for (name, rows), dashes in zip(figure_4().groupby("curve"), DASHES, strict=True):
            known = [own[arm] for arm in ARMS[str(name)] if arm in own]
            look = {"color": known[0]} if known else {"color": PAPER, "ls": dashes}
            theirs.plot(rows["million_steps"], rows["reward"], lw=1.2, label=str(name).replace("_", " "), **look)
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
