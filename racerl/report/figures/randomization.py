"""The paper's Fig. 3: laps, E_off and crashes over what is randomized and by how much, in every car."""

from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from racerl.paper import figure_3
from racerl.report.figures.style import PAPER, WIDTH, style, to_svg

SWEEP, KINDS = "domain_randomization", ("none", "friction", "all")


def draw(
    laps: pd.DataFrame, arms: Sequence[dict[str, Any]], cars: Sequence[str], colours: Mapping[tuple[str, str], str]
) -> str | None:
    """Return the SVG from laps and metrics of arms that are named none, friction_σ and all_σ; None without any.

    `colours` has every arm's by sweep and name.
    """
    names = [name for name in dict.fromkeys(laps["arm"]) if name.partition("_")[0] in KINDS]
    if not names:
        return None
    paper = {_arm(row.randomization, row.sigma): row for row in figure_3().itertuples()}
    with style():
        figure = Figure(figsize=(WIDTH, 7.2))
        axes = figure.subplots(3, len(cars), sharex=True, sharey="row", squeeze=False)
        for column, car in enumerate(cars):
            time, off, crashes = axes[:, column]
            time.set_title(car)
            for i, name in enumerate(names):
                colour = colours[SWEEP, name]
                _box(time, laps[(laps["arm"] == name) & (laps["car"] == car)]["time_s"].dropna(), i, colour)
                for row in (row for row in arms if row["arm"] == name and row["car"] == car):
                    _bar(off, i, row["e_off"], 1.0, colour)
                    _bar(crashes, i, row["crash_share"], 100.0, colour)
                if name in paper:
                    time.plot(i, paper[name].median_lap_s, "D", ms=5, color=PAPER)
                    off.plot(i, paper[name].e_off, "D", ms=5, color=PAPER)
            crashes.set_xticks(range(len(names)), [_label(name) for name in names])
        axes[0, 0].set_ylabel("lap time [s]")
        axes[1, 0].set_ylabel("E_off [m s per lap]")
        axes[2, 0].set_ylabel("laps with a crash [%]")
        figure.supxlabel(
            "randomized, σ  (boxes: quartiles of finished laps; bars: mean and 95 %; ◆ paper, real car)", fontsize=9
        )
        return to_svg(figure)


def _arm(kind: str, sigma: float) -> str:
    return kind if kind == "none" else f"{kind}_{sigma:g}"


def _label(name: str) -> str:
    kind, _, sigma = name.partition("_")
    return f"{kind}\n{sigma}"


def _box(axis: Axes, times: pd.Series, place: int, colour: str) -> None:
    if len(times):
        axis.boxplot(
            times,
            positions=[place],
            widths=0.6,
            patch_artist=True,
            manage_ticks=False,
            boxprops={"facecolor": colour, "alpha": 0.6},
            medianprops={"color": "black"},
            flierprops={"marker": ".", "markersize": 3},
        )


def _bar(axis: Axes, place: int, metric: dict[str, Any], scale: float, colour: str) -> None:
    if metric["value"] is None:
        return
    value = scale * metric["value"]
    axis.bar(place, value, width=0.6, color=colour, alpha=0.6)
    if metric["ci95"]:
        low, high = (scale * bound for bound in metric["ci95"])
        axis.plot([place, place], [low, high], color="black", lw=1.2)
