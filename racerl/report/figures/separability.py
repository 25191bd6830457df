"""How alike effects look in a log: a heat map of the cosines between what each would change."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy.cluster.hierarchy import leaves_list, linkage
from scipy.spatial.distance import squareform

from racerl.report.figures.style import WIDTH, style, to_svg


def draw(facts: Mapping[str, Any]) -> str:
    """Return the SVG of |cosine| between all effects that would show, neighbours alike."""
    names = list(facts["effects"])
    shown = [i for i, name in enumerate(names) if facts["effects"][name]["shows"]]
    cosines = np.abs(np.array(facts["cosines"]))[np.ix_(shown, shown)]
    if len(shown) > 2:
        apart = np.clip(1.0 - (cosines + cosines.T) / 2.0, 0.0, None)
        np.fill_diagonal(apart, 0.0)
        order = leaves_list(linkage(squareform(apart, checks=False), "average"))
        shown, cosines = [shown[i] for i in order], cosines[np.ix_(order, order)]
    with style():
        figure = Figure(figsize=(WIDTH, 0.9 * WIDTH))
        axis = figure.subplots()
        picture = axis.imshow(cosines, cmap="magma_r", vmin=0.0, vmax=1.0)
        labels = [names[i] for i in shown]
        axis.set_xticks(np.arange(len(labels)), labels, rotation=90, fontsize=7)
        axis.set_yticks(np.arange(len(labels)), labels, fontsize=7)
        axis.grid(visible=False)
        figure.colorbar(picture, ax=axis, shrink=0.8, label="|cosine|: 1 cannot be told apart")
        return to_svg(figure)
