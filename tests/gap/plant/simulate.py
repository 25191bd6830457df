"""Drive a batch of cars through the runs of a programme and log them."""

from __future__ import annotations

import numpy as np

from tests.gap.plant.car import N_BODY, Plant
from tests.gap.plant.effects.base import DelayLine, Steps
from tests.gap.plant.programmes import COMMAND_PERIOD, Run
from tests.gap.plant.sensors import CHANNELS, GROUPS, SAMPLE_PERIOD
from tests.gap.plant.tyre import Array

PREROLL = 0.3  # s driven before each log begins, so that late channels have a past
PAUSE = 3.0  # s between two runs


def drive(plant: Plant, runs: list[Run]) -> list[tuple[Array, dict[str, Array]]]:
    """Drive the runs in turn: for each, t (n,) in s since the log began and the channels (n, B), without noise."""
    logs, t = [], 0.0
    for run in runs:
        samples = drive_run(plant, run, t)
        channels = {name: samples[:, i].copy() for i, name in enumerate(CHANNELS)}
        for effect in plant.effects:
            effect.read(channels)
        logs.append((t + SAMPLE_PERIOD * np.arange(len(samples)), channels))
        plant.rest(PAUSE)
        t += run.duration + PAUSE
    return logs


def drive_run(plant: Plant, run: Run, start: float) -> Array:
    """One run from `start` s: the sampled channels (n, 10, B), late where a sensor is."""
    per_command, per_sample = round(COMMAND_PERIOD / plant.dt), round(SAMPLE_PERIOD / plant.dt)
    plant.place(run.pose, run.speed, start - PREROLL)
    command = run.driver(-PREROLL, plant.state)
    plant.begin(command)
    lag = lags(plant)
    line = DelayLine(int(lag.max()))
    line.fill(_truth(plant, command))
    samples = []
    for k in range(-round(PREROLL / plant.dt), round(run.duration / plant.dt)):
        if k % per_command == 0:
            command = run.driver(k * plant.dt, plant.state)
        if line.length > 1:
            line.write(_truth(plant, command))
        if k >= 0 and k % per_sample == 0:
            samples.append(line.read(lag) if line.length > 1 else _truth(plant, command))
        plant.advance(command)
    return _checked(np.stack(samples))


def lags(plant: Plant) -> Steps:
    """Whole time steps by which each channel of each car is late, (10, B)."""
    seconds = np.zeros((len(CHANNELS), plant.n_cars))
    for effect in plant.effects:
        for group, late in effect.lag().items():
            seconds[GROUPS[group]] += late
    return np.rint(seconds / plant.dt).astype(int)


def _truth(plant: Plant, command: Array) -> Array:
    """The logged channels as they are at this instant, (10, B)."""
    return np.concatenate([plant.state[:N_BODY], command])


def _checked(samples: Array) -> Array:
    """The samples, if all are finite."""
    broken = np.flatnonzero(~np.isfinite(samples).all(axis=(0, 1)))
    if len(broken):
        raise FloatingPointError(f"cars {broken.tolist()} of the batch left the real numbers")
    return samples
