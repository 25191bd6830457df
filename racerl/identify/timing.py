"""Latencies and dead times that the vehicle is given with, undone on a log, so that its channels stand side by side.

With T the latency of a channel, T_v that of the velocities and τ the dead time of a command, what belongs to the
velocities logged at t was logged at t + T − T_v − τ; it is read from the line between two samples.
"""

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pandas as pd

from racerl.data.log import Log
from racerl.errors import LogError
from racerl.vehicle.vehicle import Vehicle

DELAYED = {"delta_ref": "delta_ref", "omega_ref": "drive_ref"}  # channel of a log, command of the car


def aligned(log: Log, vehicle: Vehicle) -> Log:
    """Return the log with its channels beside its velocities; raise LogError where no run is as long as the shifts."""
    late, delays = vehicle.latencies(), vehicle.delays()
    ahead = {
        name: float(late.get(name, 0.0) - late.get("v_x", 0.0) - delays.get(DELAYED.get(name, ""), 0.0))
        for name in log.channels
    }
    ahead = {name: seconds for name, seconds in ahead.items() if seconds != 0.0}
    if not ahead:
        return log
    table = pd.concat([_moved(rows, ahead, log.dt) for rows in log.runs()], ignore_index=True)
    said = ", ".join(
        f"{name} {abs(seconds):.3g} s {'late' if seconds > 0 else 'early'}" for name, seconds in ahead.items()
    )
    if table.empty:
        raise LogError(f"{log.name}: no run is longer than the vehicle's latencies and dead times ({said})")
    return replace(
        log, table=table, remarks=(*log.remarks, f"the vehicle's latencies and dead times are undone: {said}")
    )


def _moved(rows: pd.DataFrame, ahead: Mapping[str, float], dt: float) -> pd.DataFrame:
    """Return the rows of a run for which every channel was logged, with those of `ahead` so many seconds ahead."""
    number = np.arange(len(rows))
    first = math.ceil(max(0.0, -min(ahead.values())) / dt - 1e-9)
    last = len(rows) - math.ceil(max(0.0, max(ahead.values())) / dt - 1e-9)
    moved = {name: np.interp(number + seconds / dt, number, rows[name].to_numpy()) for name, seconds in ahead.items()}
    return rows.assign(**moved).iloc[first : max(first, last)]
