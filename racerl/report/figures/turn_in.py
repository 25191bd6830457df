"""The paper's Fig. 5: steering along the track with and without an actuator model in training."""

from collections.abc import Mapping, Sequence

import pandas as pd
from matplotlib.figure import Figure

from racerl.paper import figure_5
from racerl.report.figures.style import PAPER, WIDTH, style, to_svg

POLICIES = {"with_actuator_model": "with_actuators", "without_actuator_model": "without_actuators"}  # the paper's


def draw(steering: pd.DataFrame, cars: Sequence[str], colours: Mapping[tuple[str, str], str]) -> str | None:
    """Return the SVG from rows of sweep, arm, seed, car, s_m and delta_rad; None without any.

    `colours` has every arm's by sweep and name.
    """
    if steering.empty:
        return None
    arms = {arm: colours[sweep, arm] for sweep, arm in zip(steering["sweep"], steering["arm"], strict=True)}
    paper = figure_5()
    with style():
        figure = Figure(figsize=(WIDTH, 2.2 * (len(cars) + 1)))
        axes = figure.subplots(len(cars) + 1, 1, sharex=True, sharey=True)
        for axis, car in zip(axes, cars, strict=False):
            for arm, colour in arms.items():
                mine = steering[(steering["arm"] == arm) & (steering["car"] == car)]
                for number, (_, rows) in enumerate(mine.groupby("seed")):
                    label = arm.replace("_", " ") if number == 0 else None
                    axis.plot(rows["s_m"], rows["delta_rad"], color=colour, lw=1.0, alpha=0.8, label=label)
            axis.set_title(f"{car}, median of the laps, one line per seed", fontsize=10)
        for name, rows in paper.groupby("policy", sort=False):
            colour = arms.get(POLICIES[str(name)], PAPER)
            axes[-1].plot(
                rows["s_m"], rows["delta_rad"], color=colour, lw=1.0, ls=":", label=str(name).replace("_", " ")
            )
        axes[-1].set_title("paper, real car", fontsize=10)
        axes[-1].set(xlabel="s along the centreline [m]")
        figure.supylabel("steering angle δ [rad]", fontsize=10)
        axes[0].legend(loc="lower left", bbox_to_anchor=(0.0, 1.15), ncols=2, fontsize=8)
        return to_svg(figure)
