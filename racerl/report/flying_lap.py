"""A driver's fastest lap from line to line, and how two of them compare along the track."""

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from racerl.report.subjects import Evaluation

Array = NDArray[np.floating]

SLOWEST = 0.1  # m/s, of the side slip's v_x: a car that stands points nowhere else than it goes


@dataclass(frozen=True)
class FlyingLap:
    """A finished lap.

    `samples` has t in s and s in m from the line on, x, y, v_x and delta. Where they were recorded, v_y, yaw, the
    margin to the nearer edge, one sample before the line and one after the lap are among them.
    """

    driver: str  # as a legend names it
    time_s: float
    length: float  # m, of the centreline
    samples: pd.DataFrame

    def time_at(self, s: Array) -> Array:
        """Return the time in s since the line at s (K,) in m, between 0 and the length."""
        inside = self.samples[(self.samples["s"] > 0.0) & (self.samples["s"] < self.length)]
        return np.interp(s, [0.0, *inside["s"], self.length], [0.0, *inside["t"], self.time_s])

    def side_slip(self) -> Array:
        """Return the side slip β = atan(v_y/v_x) in degrees at the samples; NaN where it was not recorded."""
        if "v_y" not in self.samples:
            return np.full(len(self.samples), np.nan)
        v_x, v_y = self.samples["v_x"].to_numpy(), self.samples["v_y"].to_numpy()
        return np.degrees(np.arctan2(v_y, np.maximum(v_x, SLOWEST)))

    def marks(self, times: Array) -> Array:
        """Return the places x, y (K, 2) in m at times (K,) in s since the line, as far as the lap goes."""
        driven = times[times <= min(self.time_s, self.samples["t"].iloc[-1])]
        return np.stack([np.interp(driven, self.samples["t"], self.samples[axis]) for axis in ("x", "y")], axis=1)


def fastest_lap(title: str, evaluation: Evaluation) -> FlyingLap | None:
    """Return a driver's fastest lap, a valid one if there is any; None when no lap was finished."""
    row, samples = evaluation.fastest_row(), evaluation.fastest_lap(beyond=1)
    if row is None or len(samples) < 2:
        return None
    length = float(evaluation.track["s_m"].iloc[-1] + evaluation.track["s_m"].iloc[1])
    s = np.unwrap(samples["s"], period=length)
    s = np.maximum.accumulate(s - length * np.round(s[0] / length))  # in a hairpin a foot point may step back
    t = samples["t"] - time_of_line(s, samples["t"].to_numpy())
    left = "" if row["valid"] else ", left the track"
    driver = f"{title} ({evaluation.metrics['car']}), {row['time_s']:.3f} s{left}"
    kept = ["x", "y", "v_x", "delta", *(name for name in ("v_y", "margin", "yaw") if name in samples)]
    return FlyingLap(driver, row["time_s"], length, samples[kept].assign(s=s, t=t))


def time_of_line(s: Array, t: Array) -> float:
    """Return when in s the line was crossed, by the first two samples that lie apart; places s in m, times t in s."""
    second = int(np.argmax(s > s[0]))
    slowness = (t[second] - t[0]) / (s[second] - s[0]) if second else 0.0
    return float(t[0] - s[0] * slowness)


def delta_time(a: FlyingLap, b: FlyingLap, s: Array) -> Array:
    """Return by how much a is later than b at s (K,) in m, in s: below 0 a is ahead."""
    return a.time_at(s) - b.time_at(s)
