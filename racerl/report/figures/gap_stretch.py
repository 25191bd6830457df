"""The stretch of a log that the refitted model misses most: measured, before and after."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from racerl.report.figures.style import COLOURS, PAPER, WIDTH, style, to_svg

MOST = 2  # channels
KINDS = {"before": ("refitted model", COLOURS[1]), "after": ("with the effects found", COLOURS[0])}


def draw(stretch: Mapping[str, Any], units: Mapping[str, str], added: bool) -> str:
    """Return the SVG of the channels that are missed most: each as measured and simulated, and the difference below."""
    kinds = [kind for kind in KINDS if added or kind == "before"]
    order = np.argsort([-_missed(stretch, c) for c in range(len(stretch["channels"]))])[:MOST]
    with style():
        figure = Figure(figsize=(WIDTH, 0.9 + 2.4 * len(order)))
        axes = figure.subplots(2 * len(order), 1, sharex=True, height_ratios=[1.2, 1.0] * len(order))
        for i, c in enumerate(order):
            name, unit = stretch["channels"][c], units.get(stretch["channels"][c], "1")
            _simulated(axes[2 * i], stretch, c, kinds)
            _difference(axes[2 * i + 1], stretch, c, kinds)
            axes[2 * i].set_ylabel(f"{name} [{unit}]")
            axes[2 * i + 1].set_ylabel(f"error [{unit}]")
        handles, labels = (a + b[-1:] for a, b in zip(*(x.get_legend_handles_labels() for x in axes[:2]), strict=True))
        axes[0].legend(handles, labels, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=4, fontsize=9)
        axes[-1].set(
            xlabel="time in the run [s]", xlim=(stretch["windows"][0]["t"][0], stretch["windows"][-1]["t"][-1])
        )
        figure.align_ylabels(list(axes))
        return to_svg(figure)


def _simulated(axis: Axes, stretch: Mapping[str, Any], c: int, kinds: list[str]) -> None:
    """Draw what was measured and what rollouts make of it, each from where its state is estimated."""
    for number, window in enumerate(stretch["windows"]):
        named = number == 0
        axis.plot(
            window["t"], window["measured"][c], color=PAPER, lw=2.6, alpha=0.5, label="measured" if named else None
        )
        for kind in kinds:
            label, colour = KINDS[kind]
            axis.plot(window["t"], window[kind][c], color=colour, lw=1.3, label=label if named else None)
        axis.axvline(window["t"][0], color=PAPER, lw=0.6, ls=":")


def _difference(axis: Axes, stretch: Mapping[str, Any], c: int, kinds: list[str]) -> None:
    """Draw simulated − measured."""
    for window in stretch["windows"]:
        for kind in kinds:
            away = np.subtract(window[kind][c], window["measured"][c])
            axis.plot(window["t"], away, color=KINDS[kind][1], lw=1.1)
        axis.axvline(window["t"][0], color=PAPER, lw=0.6, ls=":")
    spread = 2.0 * stretch["noise"][c]
    axis.axhspan(-spread, spread, color=PAPER, alpha=0.2, lw=0, label="sensor's noise, ± 2 σ")


def _missed(stretch: Mapping[str, Any], c: int) -> float:
    """Return a channel's mean squared error before, in that of its noise."""
    away = np.array([np.subtract(window["before"][c], window["measured"][c]) for window in stretch["windows"]])
    return float((away**2).mean()) / stretch["noise"][c] ** 2
