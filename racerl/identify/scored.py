"""Predictions of a log from measured initial states, apart from any fit: errors, histograms and what is overlaid."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from racerl.data.log import Log
from racerl.identify.score import START_EVERY, ErrorSum, held_errors, horizons_within, rollout_errors
from racerl.identify.windows import Wiring, cut
from racerl.vehicle.rollout import Rollout
from racerl.vehicle.vehicle import STATE

Array = NDArray[np.float64]
OVERLAY_ROLLOUTS = 6
MOST_SCORED = 5000  # rollouts


class Scored:
    """Predictions of a log from measured initial states, apart from any fit."""

    def __init__(self, rollout: Rollout, wiring: Wiring, logs: Sequence[Log], settings: Mapping[str, Any]) -> None:
        self.rollout = rollout
        self.horizons = horizons_within(settings["window"])
        # a long log is scored with fewer starts, which costs no accuracy worth having
        every = max(START_EVERY, sum(len(log.table) for log in logs) // MOST_SCORED)
        self.cut = cut(logs, wiring, rollout.vehicle, settings["window"], every, 0.0)

    def rollout_errors(self, theta: Array, index: NDArray[np.int64]) -> Array:
        """Return simulated minus measured channels of some windows, (T + 1, C, W)."""
        return rollout_errors(self.rollout, theta, self.cut.take(index))

    def errors(self, theta: Array, index: NDArray[np.int64]) -> ErrorSum:
        """Return the squared errors of some windows."""
        total = ErrorSum(self.rollout.observed, self.horizons)
        total.add(self.rollout_errors(theta, index))
        return total

    def errors_of_holding(self, index: NDArray[np.int64]) -> ErrorSum:
        """Return the squared errors of holding each window's first sample."""
        total = ErrorSum(self.rollout.observed, self.horizons)
        total.add(held_errors(self.cut.take(index)))
        return total

    def states(self) -> Array:
        """Return the measured initial states of all windows, with what drives the car in place of its actuators."""
        return self.cut.windows.initial[: len(STATE)]

    def histogram(self, theta: Array) -> dict[str, Any]:
        """Return counts of the errors at the window's end by channel, within ± 4 of its deviations, and outside."""
        errors = self.rollout_errors(theta, np.arange(self.cut.windows.count))[-1]
        table = {}
        for name, row in zip(self.rollout.observed, errors, strict=True):
            row = row[np.isfinite(row)]
            limit = 4.0 * float(np.std(self.cut.windows.measured[:, self.rollout.observed.index(name)]))
            counts, edges = np.histogram(row, bins=81, range=(-limit, limit))
            table[name] = {
                "edges": edges.tolist(),
                "counts": counts.tolist(),
                "outside": int(len(errors[0]) - counts.sum()),
            }
        return table

    def overlay(self, start: Array, theta: Array) -> pd.DataFrame:
        """Return successive rollouts through the run of median error, by rollout and channel."""
        errors = self.rollout_errors(theta, np.arange(self.cut.windows.count))
        power = np.nan_to_num((errors / self.cut.windows.measured.std(axis=(0, 2))[:, None]) ** 2, nan=np.inf)
        runs = np.unique(self.cut.run)
        by_run = np.array([power[..., self.cut.run == run].mean() for run in runs])
        run = runs[np.argsort(by_run, kind="stable")[len(runs) // 2]]
        index: list[int] = []
        reached = -1
        for i in np.flatnonzero(self.cut.run == run):
            if self.cut.start[i] >= reached and len(index) < OVERLAY_ROLLOUTS:
                index.append(int(i))
                reached = self.cut.start[i] + len(errors) - 1
        part = self.cut.take(np.array(index))
        simulated = {
            label: self.rollout.predict(values_, part.windows)
            for label, values_ in (("unfitted", start), ("fitted", theta))
        }
        time_ = (part.start + np.arange(len(errors))[:, None]) * part.windows.dt  # (T + 1, W)
        return pd.concat(
            [
                pd.DataFrame(
                    {
                        "t": time_[:, w],
                        "rollout": w,
                        "channel": name,
                        "measured": part.windows.measured[:, c, w],
                        **{label: table[:, c, w] for label, table in simulated.items()},
                    }
                )
                for c, name in enumerate(self.rollout.observed)
                for w in range(len(index))
            ],
            ignore_index=True,
        )
