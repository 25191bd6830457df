"""What a car's sensors show where effects make them wrong or late; the driver on board is not misled by them.

shown(t) = measure(true)(t − T) + noise, T the latency of each channel. Commands are held from sample to sample; a run
begins as though its first sample had been there for long.
"""

from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray

from racerl.record.simulate import Recording
from racerl.vehicle.ops import TORCH
from racerl.vehicle.vehicle import STATE, Vehicle

Array = NDArray[np.float64]
MEASURED = ("x", "y", "yaw", "delta", "omega")
COMMANDS = ("delta_ref", "omega_ref")


def as_shown(vehicle: Vehicle, recording: Recording) -> Recording:
    """Return a recording with the vehicle's sensor effects in its measurements and its stamps."""
    true = {name: torch.as_tensor(column) for name, column in zip(STATE, recording.truth.T, strict=True)}
    shown, late = vehicle.measured(true, TORCH), vehicle.latencies()
    if not late and all(shown[name] is true[name] for name in MEASURED):
        return recording
    measured, command = recording.measured.copy(), recording.command.copy()
    for i, name in enumerate(MEASURED):
        noise = recording.measured[:, i] - recording.truth[:, STATE.index(name)]
        measured[:, i] = _late(recording, shown[name].numpy(), float(late.get(name, 0.0))) + noise
    for i, name in enumerate(COMMANDS):
        command[:, i] = _late(recording, command[:, i], float(late.get(name, 0.0)), held=True)
    return replace(recording, measured=measured, command=command)


def _late(recording: Recording, column: Array, seconds: float, *, held: bool = False) -> Array:
    """Return a column (K,) as it was so many seconds before, run by run."""
    if seconds == 0.0:
        return column
    found = np.empty_like(column)
    for run in np.unique(recording.run):
        rows = np.flatnonzero(recording.run == run)
        place = np.clip(rows - seconds / recording.dt, rows[0], rows[-1])
        found[rows] = column[np.floor(place + 1e-9).astype(int)] if held else np.interp(place, rows, column[rows])
    return found
