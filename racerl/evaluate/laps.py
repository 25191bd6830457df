"""Laps: timed by interpolated crossing of the line at s = 0, scored by how far they leave the track.

A *flying* lap begins and ends with a crossing. A crash ends the lap that is being driven, on the way to the first line
too; such a lap has no time but counts as driven. e_off = max(0, −margin), integrated over the lap in m·s.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Lap:
    """One lap driven."""

    car: int
    number: int  # of the car's laps, from 1
    time_s: float | None  # None after a crash
    e_off: float  # m s
    max_off_track_m: float
    crashed: bool

    @property
    def valid(self) -> bool:
        """Whether it was finished without leaving the track."""
        return self.time_s is not None and self.max_off_track_m == 0.0


class LapTimer:
    """Follows N cars step by step and keeps their laps."""

    def __init__(self, length: float, dt: float, travelled: Array) -> None:
        self.length, self.dt = length, dt
        self.laps: list[list[Lap]] = [[] for _ in travelled]
        self._time = 0.0
        self._line = np.floor(travelled / length) + 1.0  # the next crossing of each car, in laps
        self._start: list[float | None] = [None] * len(travelled)
        self._e_off = np.zeros(len(travelled))
        self._furthest = np.zeros(len(travelled))

    def update(self, before: Array, after: Array, margin: Array, crashed: NDArray[np.bool_], restart: Array) -> None:
        """Take in one control step.

        Unwrapped distance `before` and `after` it in m, margin to the boundary after it in m, which cars crashed, and
        the distance from which those go on. All of shape (N,).
        """
        off = np.maximum(0.0, -margin)
        self._e_off += off * self.dt
        self._furthest = np.maximum(self._furthest, off)
        line = self._line * self.length
        for car in np.flatnonzero(crashed).tolist():
            self._close(car, None)
            self._open(car, None)
            self._line[car] = np.floor(restart[car] / self.length) + 1.0
        for car in np.flatnonzero((after >= line) & ~crashed).tolist():
            share = (line[car] - before[car]) / (after[car] - before[car])
            crossing = self._time + self.dt * float(share)
            if self._start[car] is not None:
                self._close(car, crossing)
            self._open(car, crossing)
            self._line[car] += 1.0
        self._time += self.dt

    def _open(self, car: int, start: float | None) -> None:
        self._start[car] = start
        self._e_off[car] = self._furthest[car] = 0.0

    def _close(self, car: int, end: float | None) -> None:
        start = self._start[car]
        self.laps[car].append(
            Lap(
                car=car,
                number=len(self.laps[car]) + 1,
                time_s=None if end is None or start is None else end - start,
                e_off=float(self._e_off[car]),
                max_off_track_m=float(self._furthest[car]),
                crashed=end is None,
            )
        )

    def current(self) -> NDArray[np.int_]:
        """Return the number of the flying lap that each car is on, 0 on the way to the line; shape (N,)."""
        return np.array(
            [0 if start is None else len(laps) + 1 for start, laps in zip(self._start, self.laps, strict=True)]
        )

    def elapsed(self) -> Array:
        """Return the time since each car began its flying lap in s, NaN on the way to the line; shape (N,)."""
        return np.array([np.nan if start is None else self._time - start for start in self._start])

    def fewest(self) -> int:
        """Return the smallest number of laps that any car has driven."""
        return min(len(laps) for laps in self.laps)


def score(laps: Sequence[Lap]) -> dict[str, Any]:
    """Return the paper's measures over laps driven; a measure without a lap to take it from is None."""
    times = np.array([lap.time_s for lap in laps if lap.time_s is not None])
    running = settled(laps)
    valid = [lap.time_s for lap in laps if lap.valid and lap.time_s is not None]
    driven = max(1, len(laps))
    return {
        "laps": len(laps),
        "valid_laps": len(valid),
        "fastest_valid_lap_s": min(valid) if valid else None,
        "mean_lap_s": float(times.mean()) if len(times) else None,
        "settled_lap_s": float(np.mean(running)) if running else None,
        "std_lap_s": float(times.std(ddof=1)) if len(times) > 1 else None,
        "mean_lap_ci95": mean_interval(laps),
        "e_off": sum(lap.e_off for lap in laps) / driven,
        "crash_share": sum(lap.crashed for lap in laps) / driven,
        "max_off_track_m": max((lap.max_off_track_m for lap in laps), default=0.0),
    }


def settled(laps: Sequence[Lap]) -> list[float]:
    """Return the times of the laps that follow another one: the first after a start is slow."""
    return [
        lap.time_s
        for before, lap in pairwise(laps)
        if before.car == lap.car and before.time_s is not None and lap.time_s is not None
    ]


def mean_interval(laps: Sequence[Lap]) -> list[float] | None:
    """Return a 95 % t-interval of the mean lap over cars; laps of one car are not independent. None below 2 cars."""
    means = [
        np.mean(times)
        for car in sorted({lap.car for lap in laps})
        if (times := [lap.time_s for lap in laps if lap.car == car and lap.time_s is not None])
    ]
    if len(means) < 2:
        return None
    half = float(stats.t.ppf(0.975, len(means) - 1) * np.std(means, ddof=1) / np.sqrt(len(means)))
    return [float(np.mean(means)) - half, float(np.mean(means)) + half]


def rows(laps: Sequence[Lap], seeds: Sequence[int]) -> list[dict[str, Any]]:
    """Return one plain row per lap, with the seed of its car."""
    return [{"seed": seeds[lap.car], **asdict(lap), "valid": lap.valid} for lap in laps]
