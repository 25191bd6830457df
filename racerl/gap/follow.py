"""The effects' own states along a whole log, led by the measured motion.

A window of a second says little of what warms up over a minute, or on which side a gap in the linkage lies; the log
before it does. With the car's own states as measured, s' = s + (1 − h ∂f/∂s)⁻¹ h f(s): linearly implicit Euler, stable
for fast lags; an actuator that was not measured follows its command likewise. Between runs the car stands.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from racerl.gap.evidence import INSTEAD, Evidence
from racerl.vehicle.actuator import Given
from racerl.vehicle.ops import CasadiOps, symbolic
from racerl.vehicle.vehicle import STATE, Vehicle

Array = NDArray[np.float64]
AXES = len(STATE)
ROWS = 500  # of a log in one call


@symbolic
def follow(vehicle: Vehicle, evidence: Evidence, shifts: Sequence[float] = (0.0, 0.0)) -> Array:
    """Return the own states (S − 8, R) of a stage's vehicle at every row of its log, inputs so many seconds late."""
    import casadi

    ops, hidden = CasadiOps(), _hidden(evidence)
    rows = [*hidden, *range(AXES, len(vehicle.states))]
    s, body = casadi.SX.sym("s", len(rows)), casadi.SX.sym("body", AXES + 3)
    state = [body[i] for i in range(AXES)] + [s[i] for i in range(len(hidden), len(rows))]
    for place, row in enumerate(hidden):
        state[row] = s[place]
    f = vehicle.derivative(casadi.vertcat(*state), body[AXES : AXES + 2], ops)[rows]
    h = body[AXES + 2]
    step = casadi.solve(casadi.SX.eye(len(rows)) - h * casadi.jacobian(f, s), h * f)
    advance = casadi.Function("advance", [s, body], [s + step]).mapaccum("follow", ROWS)
    measured = _measured(vehicle, evidence, shifts)
    size = measured.shape[1]
    measured = np.pad(measured, ((0, 0), (0, -size % ROWS)))  # by steps of no length
    states = np.zeros((len(rows), measured.shape[1] + 1))
    for first in range(0, size, ROWS):
        part = slice(first, first + ROWS)
        states[:, first + 1 : first + ROWS + 1] = advance(states[:, first], measured[:, part])
    return states[len(hidden) :, :size]


def _hidden(evidence: Evidence) -> list[int]:
    """Return the rows of actuators of which only the command is known: they are followed as own states are."""
    columns = evidence.columns
    return [i for i, name in enumerate(STATE) if name not in columns and INSTEAD.get(name) in columns]


def lagged(states: Array, evidence: Evidence, before: float, after: float) -> Array:
    """Return a first-order lag's states (R,), given as `follow` does, under another time constant in s.

    What drives it is read off its states, u = s_{k+1} + (s_{k+1} − s_k) τ/h, and led through the other lag.
    """
    h = _steps(evidence)[:-1]
    u = states[1:] + np.diff(states) * before / h
    found = np.zeros_like(states)
    ends = np.flatnonzero(np.abs(np.diff(h)) > 0.0) + 1
    for part in np.split(np.arange(len(h)), ends):  # of equal steps
        share = h[part[0]] / after
        first, last = part[0], part[-1] + 1
        keep = 1.0 / (1.0 + share)
        found[first + 1 : last + 1] = lfilter([share * keep], [1.0, -keep], u[part], zi=[keep * found[first]])[0]
    return found


def _steps(evidence: Evidence) -> Array:
    """Return the time until the next row in s, (R,)."""
    first, t = evidence.first, evidence.columns["t"]
    steps = np.full(len(first), evidence.dt)
    ends = np.flatnonzero(np.diff(first) != 0)
    steps[ends] = np.maximum(t[ends + 1] - t[ends], evidence.dt)
    return steps


def _measured(vehicle: Vehicle, evidence: Evidence, shifts: Sequence[float]) -> Array:
    """Return the car's own states, its inputs and the time until the next row, (11, R)."""
    columns = {**evidence.columns, **{name: values for name, (values, _) in evidence.smoothed.items()}}
    table = np.zeros((AXES + 3, len(evidence.first)))
    for i, name in enumerate(STATE):
        if name in columns:
            table[i] = columns[name]
    inputs = (("delta", "delta_ref", vehicle.steering), ("omega", "omega_ref", vehicle.drive))
    for i, (measured, command, actuator) in enumerate(inputs):
        name = measured if isinstance(actuator, Given) or command not in columns else command
        if name in columns:
            table[AXES + i] = evidence.late(columns[name], shifts[i])
    table[-1] = _steps(evidence)
    table[3:-1, np.flatnonzero(np.diff(evidence.first) != 0)] = 0.0  # until the next run the car stands
    return table
