"""The channels of a log over driving time, run after run; runs are set apart by thin lines."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from racerl.report.figures.style import WIDTH, colour, style, to_svg

# panels: label, channels drawn together
PANELS = (
    ("speed [m/s]", ("v_x", "omega", "omega_ref")),
    ("v_y [m/s]", ("v_y",)),
    ("yaw rate [rad/s]", ("yaw_rate",)),
    ("steering [rad]", ("delta", "delta_ref")),
    ("current [A]", ("current",)),
)
NAMES = {"v_x": "v_x", "omega": "wheel ω", "omega_ref": "ω commanded", "delta": "δ", "delta_ref": "δ commanded"}
MOST = 4000  # points drawn per channel


def draw(table: pd.DataFrame, facts: Mapping[str, Any]) -> str | None:
    """Return the SVG, or None when the log has none of the channels."""
    panels = [(label, [name for name in names if name in table]) for label, names in PANELS]
    panels = [(label, names) for label, names in panels if names]
    if not panels:
        return None
    driven = np.arange(len(table)) / facts["rate_hz"]
    borders = driven[np.flatnonzero(np.diff(table["run"].to_numpy())) + 1]
    # every run starts a new line, and of a long log every n-th row is drawn
    every = -(-len(table) // MOST)
    broken = np.concatenate([[0], np.diff(table["run"].to_numpy()[::every])]) != 0
    with style():
        figure = Figure(figsize=(WIDTH, 0.6 + 1.35 * len(panels)))
        axes = figure.subplots(len(panels), 1, sharex=True, squeeze=False).ravel()
        for axis, (label, names) in zip(axes, panels, strict=True):
            for i, name in enumerate(names):
                values = table[name].to_numpy()[::every].copy()
                values[broken] = np.nan
                axis.plot(driven[::every], values, color=colour(i), lw=0.8, label=NAMES.get(name))
            for border in borders[:200]:
                axis.axvline(border, color="black", lw=0.5, alpha=0.4)
            axis.set_ylabel(label)
            if len(names) > 1 or names[0].endswith("_ref"):
                axis.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, fontsize=8, borderpad=0.0)
        axes[-1].set(xlabel="time driven [s]", xlim=(0.0, float(driven[-1])))
        figure.align_ylabels(list(axes))
        return to_svg(figure)
