"""How cost grows: control steps per second over the number of cars, seconds of identification over the log's length."""

from collections.abc import Mapping
from typing import Any

from matplotlib.figure import Figure

from racerl.report.figures.style import WIDTH, colour, style, to_svg

RATES = {
    "env_steps_per_s_per_thread": "whole environment",
    "dynamics_steps_per_s_per_thread": "dynamics, compiled",
    "gradient_steps_per_s_per_thread": "dynamics with gradient, compiled",
    "torch_dynamics_steps_per_s_per_thread": "dynamics on torch",
}
GROWTH = {"command_seconds": "whole command", "gauss_newton_seconds": "Gauss–Newton alone"}


def draw(facts: Mapping[str, Any]) -> str | None:
    """Return the SVG about the numbers of a benchmark, or None when they hold no growth."""
    if next(iter(RATES)) in facts:
        curves = {name: _points(facts[key]) for key, name in RATES.items()}
        return _draw(curves, "cars", "control steps per second and thread", "Simulation")
    if "growth" in facts:
        rows = facts["growth"]
        minutes = [row["log_seconds"] / 60 for row in rows]
        curves = {name: (minutes, [row[key] for row in rows]) for key, name in GROWTH.items()}
        return _draw(curves, "log [min]", "seconds", f"Identification, {facts['threads']} threads")
    return None


def _points(rates: Mapping[str, float]) -> tuple[list[float], list[float]]:
    return [float(count) for count in rates], list(rates.values())


def _draw(curves: Mapping[str, tuple[list[float], list[float]]], along: str, up: str, title: str) -> str:
    with style():
        figure = Figure(figsize=(WIDTH, 3.8))
        axes = figure.subplots()
        for i, (name, (x, y)) in enumerate(curves.items()):
            axes.plot(x, y, "o-", ms=4, color=colour(i), label=name)
        axes.set(xscale="log", yscale="log", xlabel=along, ylabel=up, title=title)
        axes.legend(fontsize=9)
        return to_svg(figure)
