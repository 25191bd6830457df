"""Measured channels with simulated rollouts laid over them, each from the measured state at its start."""

import pandas as pd
from matplotlib.figure import Figure

from racerl.report.figures.style import COLOURS, PAPER, WIDTH, style, to_svg

LABELS = {
    "v_x": "v_x [m/s]",
    "v_y": "v_y [m/s]",
    "yaw_rate": "yaw rate [rad/s]",
    "delta": "steering δ [rad]",
    "omega": "wheel speed ω [m/s]",
}


def draw(table: pd.DataFrame, fitted: bool) -> str:
    """Return the SVG of one panel per channel."""
    channels = list(dict.fromkeys(table["channel"]))
    with style():
        figure = Figure(figsize=(WIDTH, 0.9 + 1.7 * len(channels)))
        axes = figure.subplots(len(channels), 1, sharex=True, squeeze=False).ravel()
        for axis, channel in zip(axes, channels, strict=True):
            rows = table[table["channel"] == channel]
            for number, rollout in rows.groupby("rollout"):
                first = number == 0
                time = rollout["t"]
                axis.plot(
                    time, rollout["measured"], color=PAPER, lw=2.2, alpha=0.5, label="measured" if first else None
                )
                if fitted:
                    axis.plot(
                        time, rollout["unfitted"], color=COLOURS[1], lw=1.0, ls="--", label="before" if first else None
                    )
                name = "identified" if fitted else "simulated"
                axis.plot(time, rollout["fitted"], color=COLOURS[0], lw=1.3, label=name if first else None)
                axis.axvline(float(time.iloc[0]), color="black", lw=0.6, ls=":")
            axis.set_ylabel(LABELS[channel])
        axes[0].legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, fontsize=9)
        axes[-1].set(xlabel="time in the run [s]", xlim=(float(table["t"].min()), float(table["t"].max())))
        figure.align_ylabels(list(axes))
        return to_svg(figure)
