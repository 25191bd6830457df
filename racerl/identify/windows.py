"""From logs to windows: stretches of equal length that never cross a run, and what drives the car in them.

An actuator is driven by its command where one was logged, held over the sample that follows it; else its measured
state is the input, by its mean over each sample.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from racerl.data.log import VELOCITY, Log, common_sample_time
from racerl.errors import LogError
from racerl.estimation.windows import window_starts
from racerl.vehicle.rollout import Windows, drive_by, settle
from racerl.vehicle.vehicle import STATE, Vehicle

Array = NDArray[np.float64]
INPUTS = ("auto", "commands", "measured")
ACTUATORS = (("delta", "delta_ref"), ("omega", "omega_ref"))  # state and command


@dataclass(frozen=True)
class Wiring:
    """What a fit sees of a log: the channel that drives each actuator, and the states that are compared."""

    steering: str
    drive: str
    observed: tuple[str, ...]

    def driven(self, vehicle: Vehicle) -> Vehicle:
        """Return the vehicle with measured actuators as inputs where commands are missing."""
        return drive_by(vehicle, measured_steering=self.steering == "delta", measured_speed=self.drive == "omega")


@dataclass(frozen=True)
class Cut:
    """Windows with where they come from: the run's number and the first row within it."""

    windows: Windows
    run: NDArray[np.int64]
    start: NDArray[np.int64]

    def take(self, index: NDArray[np.int64]) -> "Cut":
        """Return some of the windows."""
        return Cut(self.windows.take(index), self.run[index], self.start[index])

    def still(self, wiring: Wiring) -> tuple[str, ...]:
        """Return the actuators whose commands never change in a run, and that are where they were commanded.

        Left free, such an angle lets a slow actuator pass for what the car does on a circle.
        """
        first = np.unique(self.run, return_index=True)[1][np.unique(self.run, return_inverse=True)[1]]
        inputs = self.windows.inputs
        channels = ((name, i) for i, (name, _) in enumerate(ACTUATORS) if (wiring.steering, wiring.drive)[i] != name)
        return tuple(
            name for name, i in channels if (inputs[:, i] == inputs[0, i, first]).all() and self._there(name, i, wiring)
        )

    def _there(self, name: str, channel: int, wiring: Wiring) -> bool:
        """Return whether an actuator was where it was commanded, but for its sensor's noise, where it was measured."""
        if name not in wiring.observed:
            return True
        shown = self.windows.measured[:, wiring.observed.index(name)]
        noise = 0.5 * np.mean(np.diff(shown, axis=0) ** 2)  # its variance, from neighbours
        return bool(np.mean((shown[1:] - self.windows.inputs[:, channel]) ** 2) <= 2.0 * noise)

    def observing(self, channels: slice) -> "Cut":
        """Return the windows with some of the observed channels alone."""
        measured, weight = (
            np.ascontiguousarray(part) for part in (self.windows.measured[:, channels], self.windows.weight[channels])
        )
        return replace(self, windows=replace(self.windows, measured=measured, weight=weight))


def choose_wiring(logs: Sequence[Log], inputs: str = "auto") -> Wiring:
    """Return what all the logs offer; raise LogError for what can't be done without."""
    common = set.intersection(*(set(log.channels) for log in logs))
    names = ", ".join(log.name for log in logs)
    missing = [channel for channel in VELOCITY if channel not in common]
    if missing:
        raise LogError(
            f"{names}: {', '.join(missing)} missing; velocities come from x, y, yaw or are channels themselves"
        )
    chosen = []
    for state, command in ACTUATORS:
        wanted = {"auto": (command, state), "commands": (command,), "measured": (state,)}[inputs]
        channel = next((name for name in wanted if name in common), None)
        if channel is None:
            raise LogError(f"{names}: {' and '.join(wanted)} missing; a rollout needs one of {state}, {command}")
        chosen.append(channel)
    steering, drive = chosen
    observed = [*VELOCITY]
    observed += [
        state for (state, _), channel in zip(ACTUATORS, chosen, strict=True) if channel != state and state in common
    ]
    return Wiring(steering, drive, tuple(observed))


def cut(logs: Sequence[Log], wiring: Wiring, vehicle: Vehicle, length: int, stride: int, slowest: float) -> Cut:
    """Cut runs into windows of `length` intervals, one every `stride` samples.

    Windows in which the car is slower than `slowest` m/s are left out. The weights are one. Raises LogError when no
    run is long enough or none moves.
    """
    dt = common_sample_time(logs)
    parts = list(_cut_runs(logs, wiring, vehicle, length, stride, slowest))
    longest = max(len(rows) for log in logs for rows in log.runs())
    if not parts and longest <= length:
        raise LogError(
            f"{', '.join(log.name for log in logs)}: the longest run has {longest} samples, a window needs "
            f"{length + 1}; give a longer log or window={max(longest - 1, 1)}"
        )
    if not parts:
        raise LogError(f"{logs[0].name}: the car never stays above {slowest:g} m/s for a window of {length * dt:g} s")
    initial, inputs, measured, run, start = zip(*parts, strict=True)
    stacked = np.concatenate(measured, axis=2)
    windows = Windows(
        np.concatenate(initial, axis=1),
        np.concatenate(inputs, axis=2),
        stacked,
        np.ones(stacked.shape[1:]),
        dt,
    )
    settle(vehicle, windows)
    found = Cut(windows, np.concatenate(run), np.concatenate(start))
    for name in found.still(wiring):
        channel = [state for state, _ in ACTUATORS].index(name)
        windows.initial[STATE.index(name)] = windows.inputs[0, channel]
    return found


def _cut_runs(
    logs: Sequence[Log], wiring: Wiring, vehicle: Vehicle, length: int, stride: int, slowest: float
) -> Iterator[tuple[Array, Array, Array, NDArray[np.int64], NDArray[np.int64]]]:
    number = -1
    for log in logs:
        for rows in log.runs():
            number += 1
            starts = window_starts(len(rows), length, stride, rows["v_x"].to_numpy(), slowest)
            if not len(starts):
                continue
            index = starts + np.arange(length + 1)[:, None]  # (T + 1, W)
            column = {name: rows[name].to_numpy()[index] for name in ("t", *log.channels)}
            inputs = np.stack([_input(name, column[name]) for name in (wiring.steering, wiring.drive)], axis=1)
            measured = np.stack([column[name] for name in wiring.observed], axis=1)
            yield (
                _initial(vehicle, column, wiring, len(starts)),
                inputs,
                measured,
                np.full(len(starts), number),
                starts,
            )


def _input(name: str, column: Array) -> Array:
    """Return what drives the car over each interval (T, W): a command as it was sent, the mean of a measured state."""
    return 0.5 * (column[:-1] + column[1:]) if name in STATE else column[:-1]


def _initial(vehicle: Vehicle, column: dict[str, Array], wiring: Wiring, count: int) -> Array:
    """Return the first guess of each window's initial state (S, W): what was measured, commands for actuators."""
    state = np.zeros((len(vehicle.states), count))
    for i, name in enumerate(STATE):
        if name in column:
            state[i] = column[name][0]
    for i, name in enumerate(vehicle.states):
        if name.endswith(".clock"):  # effects over time begin with the log's own time
            state[i] = column["t"][0]
    for (name, _), channel in zip(ACTUATORS, (wiring.steering, wiring.drive), strict=True):
        if name not in column:
            state[STATE.index(name)] = column[channel][0]
    return state


def channel_scale(logs: Sequence[Log], observed: Sequence[str]) -> Array:
    """Return the standard deviation of each observed channel over all logs, (C,)."""
    scale = np.array([np.std(np.concatenate([log.array(name) for log in logs])) for name in observed])
    if not (scale > 0).all():
        still = observed[int(np.argmin(scale))]
        raise LogError(f"{logs[0].name}: {still} never changes; a fit needs a car that is driven")
    return scale
