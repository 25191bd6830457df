"""What the blind test of the gap workflow found: how often each size of effect is named, and what it is called."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from racerl.report.figures.style import COLOURS, WIDTH, style, to_svg

SIZES = ("small", "medium", "large")
MARKERS = "osDv^"


def draw_detection(cells: Sequence[Mapping[str, Any]]) -> str | None:
    """Return the SVG of the share of right names over the effect's size; None without single effects."""
    if not cells:
        return None
    noises = sorted({cell["noise"] for cell in cells})
    series = sorted({(cell["programme"], cell["noise"]) for cell in cells})
    programmes = sorted({programme for programme, _ in series})
    with style():
        figure = Figure(figsize=(WIDTH, 3.6))
        axis = figure.subplots()
        for i, (programme, noise) in enumerate(series):
            mine = {c["size"]: c for c in cells if (c["programme"], c["noise"]) == (programme, noise)}
            sizes = [size for size in SIZES if size in mine]
            share = np.array([mine[size]["share"] for size in sizes]) * 100
            low, high = np.array([mine[size]["ci95"] for size in sizes]).T * 100
            axis.errorbar(
                [SIZES.index(size) + 0.09 * (i - (len(series) - 1) / 2) for size in sizes],
                share,
                np.clip([share - low, high - share], 0.0, None),
                fmt=MARKERS[noises.index(noise) % len(MARKERS)],
                color=COLOURS[programmes.index(programme)],
                capsize=3,
                label=f"{programme}, noise × {noise:g} ({sum(mine[size]['of'] for size in sizes)} logs)",
            )
        axis.set_xticks(range(len(SIZES)), SIZES)
        axis.set(xlabel="size of the hidden effect", ylabel="called by its name / %", ylim=(-3, 103), xlim=(-0.5, 2.5))
        figure.legend(loc="outside right center", fontsize=8)
        return to_svg(figure)


def draw_confusion(table: Mapping[str, Mapping[str, int]]) -> str | None:
    """Return the SVG of what was said of each hidden effect that was not always called by its name; None if none."""
    missed = [name for name, said in table.items() if set(said) != {name}]
    if not missed:
        return None
    said = sorted({word for name in missed for word in table[name]}, key=lambda word: (word not in missed, word))
    counts = np.array([[table[name].get(word, 0) for word in said] for name in missed])
    with style():
        figure = Figure(figsize=(WIDTH, 1.9 + 0.24 * len(missed)))
        axis = figure.subplots()
        axis.imshow(counts, cmap="Blues", aspect="auto", vmin=0, vmax=max(2, counts.max()))
        for (i, j), count in np.ndenumerate(counts):
            if count:
                own = missed[i] == said[j]
                colour = "white" if count > 0.6 * counts.max() and counts.max() > 1 else "black"
                axis.text(j, i, str(count), ha="center", va="center", color=colour, weight="bold" if own else "normal")
        axis.set_xticks(range(len(said)), [_short(word) for word in said], rotation=40, ha="right", fontsize=8)
        axis.set_yticks(range(len(missed)), missed, fontsize=8)
        axis.set(xlabel="said (logs; bold: the truth)", ylabel="hidden")
        axis.grid(visible=False)
        return to_svg(figure)


def _short(said: str) -> str:
    """Return names that fit under a column; three or more of them are counted."""
    names = said.split(" + ")
    return f"{len(names)} effects" if len(names) > 2 else said
