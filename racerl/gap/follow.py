"""The effects' own states along a whole log, led by the measured motion.

A window of a second says little of what warms up over a minute, or on which side a gap in the linkage lies; the log
before it does. With the car's own states as measured, s' = s + (1 − h ∂f/∂s)⁻¹ h f(s): linearly implicit Euler, stable
for fast lags. Between runs the car stands.
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from racerl.gap.evidence import Evidence
from racerl.vehicle.actuator import Given
from racerl.vehicle.ops import CasadiOps
from racerl.vehicle.vehicle import STATE, Vehicle

Array = NDArray[np.float64]
AXES = len(STATE)


def follow(vehicle: Vehicle, evidence: Evidence) -> Array:
    """Return the own states (S − 8, R) of a stage's vehicle at every row of its log."""
    import casadi

    ops, own = CasadiOps(), len(vehicle.states) - AXES
    s, body = casadi.SX.sym("s", own), casadi.SX.sym("body", AXES + 3)
    state = casadi.vertcat(body[:AXES], s)
    f = vehicle.derivative(state, body[AXES : AXES + 2], ops)[AXES:]
    h = body[AXES + 2]
    step = casadi.solve(casadi.SX.eye(own) - h * casadi.jacobian(f, s), h * f)
    rows = len(evidence.first)
    advance = casadi.Function("advance", [s, body], [s + step]).mapaccum("follow", rows)
    start = np.zeros(own)
    after = np.asarray(advance(start, _measured(vehicle, evidence.columns, evidence.first, evidence.dt)))
    return np.concatenate([start[:, None], after[:, :-1]], axis=1)


def _measured(vehicle: Vehicle, columns: Mapping[str, Array], first: NDArray[np.int64], dt: float) -> Array:
    """Return the car's own states, its inputs and the time until the next row, (11, R)."""
    rows = len(first)
    table = np.zeros((AXES + 3, rows))
    for i, name in enumerate(STATE):
        if name in columns:
            table[i] = columns[name]
    inputs = (("delta", "delta_ref", vehicle.steering), ("omega", "omega_ref", vehicle.drive))
    for i, (measured, command, actuator) in enumerate(inputs):
        name = measured if isinstance(actuator, Given) or command not in columns else command
        if name in columns:
            table[AXES + i] = columns[name]
    table[-1] = dt
    ends = np.flatnonzero(np.diff(first) != 0)
    table[3:-1, ends] = 0.0  # until the next run the car stands
    table[-1, ends] = np.maximum(columns["t"][ends + 1] - columns["t"][ends], dt)
    return table
