"""What a log says about one stage: equal windows with inputs at any shift in time, and each channel's noise."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.signal import savgol_filter

from racerl.data.agreement import compare_with_poses
from racerl.data.differentiate import velocities
from racerl.data.log import POSE, VELOCITY, Log, common_sample_time
from racerl.data.noise import channel_noise, spread, whiteness
from racerl.estimation.windows import window_starts
from racerl.gap.stage import Stage
from racerl.vehicle.rollout import Windows
from racerl.vehicle.vehicle import STATE

Array = NDArray[np.float64]
Index = NDArray[np.int64]
MARGIN = 25  # samples of a run before its first window, so that late inputs are known
SMOOTH = (33, 17, 9, 5)  # samples of the quadratic Savitzky–Golay filters that measured inputs may be smoothed by
STEEP = 2  # samples more for their slopes
SLOPE = 7  # samples that a condition's slope is taken over
QUIET, PART = 2.0, 50  # most mean square over so many samples, in that of the noise, that smoothing may take away
WHITE = 0.9  # least share of noise near the Nyquist frequency in what is fast, if it is white
LEAST = 1e-9  # deviation of a noise at least
STILL = 1e-6  # rad or rad/s, deviation of an actuator from a command that never changes
COMMANDS = ("delta_ref", "omega_ref")
INSTEAD = {"delta": "delta_ref", "omega": "omega_ref"}  # where an actuator that was not measured may be
FILTERS = [(window, order) for order in (2, 3) for window in range(5, 42, 2)]  # that velocities may have been made by
LATE = 0.015  # s, by which velocities may lag poses
ALIKE = 0.3  # of a velocity's noise by which it may differ from such a derivative


def channels_of(logs: Sequence[Log]) -> set[str]:
    """Return the channels that all logs have."""
    return set.intersection(*(set(log.channels) for log in logs))


@dataclass(frozen=True)
class Evidence:
    """The rows of some logs, run after run, and the windows of a stage in them.

    `columns` (R,) by channel; `first`, `last` (R,): the rows of the run that a row belongs to. `start`, `run` (W,):
    first row and run of each window of `length` intervals of dt seconds.
    """

    stage: Stage
    columns: dict[str, Array]
    first: Index
    last: Index
    start: Index
    run: Index
    length: int
    dt: float
    observed: tuple[str, ...]  # the stage's outputs that were measured, not made from others
    early: float = 0.0  # s, by which commands were sent before the sample that first shows them

    @classmethod
    def of(cls, logs: Sequence[Log], stage: Stage, length: int, slowest: float) -> "Evidence | None":
        """Cut windows side by side; None where the logs lack what the stage needs.

        Windows in which the car is slower than `slowest` m/s are left out but for the steering: tyres are stiff there.
        Raises LogError where the logs differ in the time between samples.
        """
        dt = common_sample_time(logs)
        channels = channels_of(logs)
        if not channels >= set(stage.needed) or not channels & set(stage.outputs):
            return None
        runs = [rows for log in logs for rows in log.runs()]
        size = np.array([len(rows) for rows in runs])
        first = np.repeat(np.cumsum(size) - size, size)
        last = np.repeat(np.cumsum(size) - 1, size)
        columns = {name: np.concatenate([rows[name].to_numpy() for rows in runs]) for name in ("t", *channels)}
        columns |= {name: np.zeros(len(first)) for name in stage.inputs if name not in channels}
        if "yaw" in columns:
            columns["yaw"] = np.concatenate([np.unwrap(rows["yaw"].to_numpy()) for rows in runs])
        start, run = [], []
        for number, (begin, rows) in enumerate(zip(np.cumsum(size) - size, size, strict=True)):
            slow = stage.name != "steering" and "v_x" in columns
            speed = columns["v_x"][begin : begin + rows] if slow else None
            places = window_starts(rows, length, length, speed, slowest, before=MARGIN, after=1)
            start.append(begin + places)
            run.append(np.full(len(places), number))
        observed = [name for name in stage.outputs if name in channels]
        if {*POSE, *VELOCITY} <= set(observed):
            if derived(runs, dt):
                observed = list(POSE)
            elif contradictory(logs):
                observed = list(VELOCITY)
        return cls(stage, columns, first, last, np.concatenate(start), np.concatenate(run), length, dt, tuple(observed))

    def parted(self, length: int) -> "Evidence":
        """Return the same rows in windows of `length` intervals, as many as fit into each window side by side."""
        parts = np.arange(0, self.length - length + 1, length)
        start = (self.start[:, None] + parts).ravel()
        return replace(self, start=start, run=np.repeat(self.run, len(parts)), length=length)

    @property
    def numbers(self) -> int:
        """How many numbers a window measures."""
        return len(self.observed) * (self.length + 1)

    def windows(self, states: Sequence[str], shifts: Sequence[float]) -> Windows:
        """Return all windows, inputs shifted by so many seconds (later if positive), with measured initial states."""
        rows = self.start[:, None] + np.arange(self.length + 1)  # (W, T + 1)
        given = [self._input(name, rows[:, :-1], shift) for name, shift in zip(self.stage.inputs, shifts, strict=True)]
        inputs = np.stack([value for value, _ in given] + [slope for _, slope in given])  # (4, W, T)
        measured = np.stack([self.columns[name][rows] for name in self.observed])  # (C, W, T + 1)
        initial = np.zeros((len(states), len(self.start)))
        for i, name in enumerate(states):
            source = INSTEAD.get(name) if name not in self.columns or self._stands(name) else name
            if name in STATE and source in self.columns:
                initial[i] = self.columns[source][self.start]
        return Windows(
            initial,
            np.ascontiguousarray(inputs.transpose(2, 0, 1)),
            np.ascontiguousarray(measured.transpose(2, 0, 1)),
            np.ones((len(measured), len(self.start))),
            self.dt,
        )

    def _input(self, name: str, rows: Index, shift: float) -> tuple[Array, Array]:
        """Return a channel's mean over the intervals that begin at `rows`, `shift` seconds before, and its slope."""
        late = shift / self.dt
        if name in COMMANDS:  # held from sample to sample
            late -= self.early / self.dt
            whole = int(np.floor(late))
            newer, older = (self._at(self.columns[name], rows - k) for k in (whole, whole + 1))
            return newer + (late - whole) * (older - newer), (newer - older) / self.dt
        values, slopes = self.smoothed[name]
        place = 0.5 - late
        whole = int(np.floor(place))
        share = place - whole
        return tuple(  # type: ignore[return-value]
            (1.0 - share) * self._at(column, rows + whole) + share * self._at(column, rows + whole + 1)
            for column in (values, slopes)
        )

    @cached_property
    def runs(self) -> list[slice]:
        """The rows of each run."""
        return [slice(begin, self.last[begin] + 1) for begin in np.unique(self.first)]

    def late(self, column: Array, seconds: float) -> Array:
        """Return a column (R,) that comes so many seconds later, held at the ends of each run."""
        if seconds == 0.0:
            return column
        whole = int(np.floor(seconds / self.dt))
        rows, share = np.arange(len(column)) - whole, seconds / self.dt - whole
        newer, older = (column[np.clip(rows - k, self.first, self.last)] for k in (0, 1))
        return newer + share * (older - newer)

    def _at(self, column: Array, rows: Index) -> Array:
        """Return a column at rows, held before the first and after the last row of each window's run."""
        ends = self.start[:, None]
        taken: Array = column[np.clip(rows, self.first[ends], self.last[ends])]
        return taken

    @cached_property
    def smoothed(self) -> dict[str, tuple[Array, Array]]:
        """Measured inputs and their slopes (R,), smoothed run by run."""
        return {name: self._smooth(name) for name in self.stage.inputs if name not in COMMANDS}

    def _smooth(self, name: str) -> tuple[Array, Array]:
        """Return a channel and its slope, smoothed as far as nothing but noise is lost: its noise moves the car."""
        noise = float(self.noise_of([name])[0])
        for window in SMOOTH:
            values = self._filtered(name, window)
            if _quiet(self.columns[name] - values, noise):
                break
        return values, self._filtered(name, window + STEEP, deriv=1)

    def _filtered(self, name: str, window: int, deriv: int = 0) -> Array:
        """Return a channel or its slope, filtered run by run; as it is, or zero, in runs that are too short."""
        values = np.zeros(len(self.first)) if deriv else self.columns[name].copy()
        for run in self.runs:
            part = self.columns[name][run]
            if len(part) >= window:
                values[run] = savgol_filter(part, window, 2, deriv=deriv, delta=self.dt, mode="interp")
        return values

    def slope(self, name: str) -> Array:
        """Return a channel's time derivative (R,), over some samples of its run; zero in runs that are shorter."""
        return self._filtered(name, SLOPE, deriv=1)

    def trust(self, name: str) -> float:
        """Return how precisely a window's initial state is known from its measurement, in 1/σ².

        Zero for outputs, whose first sample is among the residuals, and for what was not measured; but an actuator
        that stands is where it was commanded.
        """
        if self._stands(name):
            return STILL**-2
        return 0.0 if name in self.stage.outputs or name not in self.columns else float(self.noise_of([name])[0]) ** -2

    def _stands(self, name: str) -> bool:
        """Return whether an actuator's command is the same throughout each run, and it stands there but for noise.

        Such a log tells nothing of how fast the actuator is: a window that began elsewhere would only follow noise.
        """
        command = INSTEAD.get(name)
        if command not in self.columns or (self.columns[command] != self.columns[command][self.first]).any():
            return False
        if name not in self.columns:
            return True
        away = self.columns[name] - self.columns[command]  # of one that does not get there, windows begin where it is
        return bool(np.mean(away**2) < QUIET * self.noise_of([name])[0] ** 2)

    def noise(self) -> Array:
        """Return the standard deviation of each output's noise, (C,): what local polynomials do not follow."""
        return self.noise_of(self.observed)

    @property
    def filtered(self) -> bool:
        """Whether most outputs were filtered before they were logged: noise that is not white is larger than shown."""
        run = max(self.runs, key=lambda run: run.stop - run.start)
        return float(np.median([whiteness(self.columns[name][run]) for name in self.observed])) < WHITE

    def with_noisy_inputs(self, generator: np.random.Generator) -> "Evidence":
        """Return the evidence with as much noise again on every measured input; commands are known."""
        columns = dict(self.columns)
        for name in self.stage.inputs:
            if name not in COMMANDS:
                columns[name] = columns[name] + self.noise_of([name])[0] * generator.standard_normal(len(self.first))
        return replace(self, columns=columns)

    def noise_of(self, names: Sequence[str]) -> Array:
        """Return the standard deviation of some channels' noise."""
        for name in names:
            if name not in self._deviations:
                self._deviations[name] = max(channel_noise([self.columns[name][run] for run in self.runs]), LEAST)
        return np.array([self._deviations[name] for name in names])

    @cached_property
    def _deviations(self) -> dict[str, float]:
        """The noise of channels as far as it was asked for."""
        return {}


def contradictory(logs: Sequence[Log]) -> bool:
    """Return whether velocities lag the poses that they belong to, so that no car could show both."""
    compared = [found for log in logs if (found := compare_with_poses(log)) is not None]
    return any(found.lag is not None and abs(found.lag.seconds) > LATE for found in compared)


def derived(runs: Sequence[pd.DataFrame], dt: float) -> bool:
    """Return whether the velocities were made from the poses: some Savitzky–Golay derivative gives them.

    Such velocities say nothing that the poses do not, and they round off whatever is faster than their filter.
    """
    run = max(runs, key=len)
    given = run[list(VELOCITY)].to_numpy().T
    x, y, yaw = (run[name].to_numpy() for name in POSE)
    noise = np.array([spread(column) for column in given])
    for window, order in FILTERS:
        if len(run) > 2 * window:
            made = np.array(velocities(x, y, yaw, dt, window, order))
            inner = slice(window, -window)
            if (np.median(np.abs(made - given)[:, inner], axis=1) < ALIKE * np.maximum(noise, 1e-6)).all():
                return True
    return False


def _quiet(lost: Array, noise: float) -> bool:
    """Return whether what smoothing took away is noise throughout."""
    parts = lost[: len(lost) // PART * PART].reshape(-1, PART)
    return bool(((parts**2).mean(axis=1) < QUIET * noise**2).all())
