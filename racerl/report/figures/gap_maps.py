"""Where the error grows: its power over conditions of driving, before and after."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from racerl.report.figures.style import COLOURS, PAPER, WIDTH, style, to_svg

COLUMNS, MOST = 3, 6


def draw(
    before: Sequence[dict[str, Any]], after: Sequence[dict[str, Any]], where: Sequence[dict[str, Any]]
) -> str | None:
    """Return the SVG of the clearest maps, one panel each; None where no map is clear."""
    chosen = _chosen(before, where)
    if not chosen:
        return None
    later = {_key(row): row for row in after}
    rows = -(-len(chosen) // COLUMNS)
    with style():
        figure = Figure(figsize=(WIDTH, 0.5 + 2.3 * rows))
        axes = figure.subplots(rows, COLUMNS, squeeze=False).ravel()
        for axis, row in zip(axes, chosen, strict=False):
            _steps(axis, row, COLOURS[1], "refitted model")
            if _key(row) in later:
                _steps(axis, later[_key(row)], COLOURS[0], "with the effects found")
            axis.axhline(1.0, color=PAPER, linewidth=1, linestyle=":", label="sensors' noise")
            axis.set_xlabel(f"{row['title']} / {row['unit']}" if row["unit"] else row["title"])
            axis.set_title(row["channel"], loc="right", fontsize=9)
            axis.set_ylim(bottom=0.0)
        for axis in axes[len(chosen) :]:
            axis.set_visible(False)
        for axis in axes[::COLUMNS]:
            axis.set_ylabel("growth² / noise²")
        figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper left", ncols=3, fontsize=9)
        return to_svg(figure)


def _key(row: dict[str, Any]) -> tuple[str, str, str]:
    return row["stage"], row["channel"], row["condition"]


def _chosen(maps: Sequence[dict[str, Any]], where: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the maps that the clues come from."""
    titles = [(clue["stage"], clue["channel"], clue["condition"]) for clue in where]
    found = []
    for stage, channel, text in titles:
        found += [
            r for r in maps if r["stage"] == stage and r["channel"] == channel and text.startswith(f"{r['title']} ")
        ]
    return found[:MOST]


def _steps(axis: Any, row: dict[str, Any], colour: str, label: str) -> None:
    axis.stairs(np.array(row["power"]), np.array(row["edges"]), color=colour, linewidth=1.6, label=label)
