"""Model against twin: what every arm's laps come to in the cars it was raced in; a colour per arm, a marker per car."""

from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib.figure import Figure

from racerl.report.figures.style import PAPER, WIDTH, style, to_svg

PANELS = (
    ("lap_time", "mean lap [s]", 1.0),
    ("e_off", "E_off [m s per lap]", 1.0),
    ("crash_share", "crashes [%]", 100.0),
)
MARKERS = "osD^v"  # of cars


def draw(arms: Sequence[dict[str, Any]], colours: Mapping[tuple[str, str], str]) -> str | None:
    """Return the SVG from the metrics of arms in cars, `colours` by sweep and arm; None without any."""
    panels = [panel for panel in PANELS if any(row[panel[0]]["value"] is not None for row in arms)]
    if not panels:
        return None
    names = list(dict.fromkeys((row["sweep"], row["arm"]) for row in arms))
    cars = list(dict.fromkeys(row["car"] for row in arms))
    with style():
        figure = Figure(figsize=(WIDTH, 1.2 + 0.3 * len(names)))
        axes = figure.subplots(1, len(panels), sharey=True, squeeze=False).ravel()
        for axis, (metric, title, scale) in zip(axes, panels, strict=True):
            for row in arms:
                if row[metric]["value"] is None:
                    continue
                i, colour = cars.index(row["car"]), colours[row["sweep"], row["arm"]]
                place = names.index((row["sweep"], row["arm"])) + 0.14 * (2 * i - len(cars) + 1)
                if row[metric]["ci95"]:
                    axis.plot([scale * bound for bound in row[metric]["ci95"]], [place, place], color=colour, lw=1.4)
                axis.plot(scale * row[metric]["value"], place, _marker(i), ms=4, color=colour)
            axis.set(xlabel=title)
        axes[0].set_yticks(range(len(names)), [f"{sweep}: {arm}".replace("_", " ") for sweep, arm in names], fontsize=8)
        axes[0].invert_yaxis()
        handles = [
            axes[0].plot([], [], f"{_marker(i)}-", ms=4, color=PAPER, label=car)[0] for i, car in enumerate(cars)
        ]
        figure.legend(handles=handles, loc="outside upper right", ncols=len(cars), fontsize=8)
        return to_svg(figure)


def _marker(car: int) -> str:
    return MARKERS[car % len(MARKERS)]
