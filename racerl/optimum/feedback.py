"""A lap as a controller: linear-quadratic feedback about it, valid near it.

At places s on the line, e = z − z*(s) is the deviation of the states of `collocation` from the lap. Driving on for a
control period with the action held moves a deviation by  e' = A e + B v,  taken across the lap: where the car gets
further along the line than the lap does, it is compared with the lap there. The action is u*(s) − K(s) e, with K from
the Riccati recursion, repeated round the lap until it is periodic.
"""

from dataclasses import dataclass
from typing import Any

import casadi
import numpy as np
from numpy.typing import NDArray

from racerl.env.actions import Action
from racerl.errors import OptimumError
from racerl.optimum.along import OMEGA, V_X, V_Y, XI, YAW_RATE, N, motion
from racerl.optimum.collocation import Solution
from racerl.optimum.corridor import Corridor
from racerl.vehicle.integrate import rk4

PLACES = 400  # round the lap
ROUNDS = 400  # of the recursion, at most
SETTLED = 1e-6
# deviations that cost as much as a full correction, in shares of half-width w, top speed V, V/w and 1 rad
TOLERANCES = {N: 0.1, XI: 0.1, V_X: 0.06, V_Y: 0.06, YAW_RATE: 0.06, OMEGA: 0.2}
CORRECTIONS = (0.3, 0.5)  # of steering and drive, in their scaled units

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Feedback:
    """Tables over `PLACES` even places round the line."""

    states: Array  # (M, Z)
    actions: Array  # (M, 2), scaled to ± 1
    gains: Array  # (M, 2, Z)
    tolerances: Array  # (Z,): a deviation of this size is large; infinite where it does not matter


def regulate(
    solution: Solution, action: Action, corridor: Corridor, width: float, dt: float, substeps: int, ahead: float = 0.0
) -> Feedback:
    """Return the feedback about a lap for a policy that acts every dt seconds; `width` is the half-width in m.

    Actions are those that the lap has `ahead` seconds further on.
    """
    length = corridor.length
    s = np.arange(PLACES) * (length / PLACES)
    known = np.concatenate([[0.0], solution.stretch.s])
    table = np.column_stack([solution.states[:, -1], solution.states])
    lap = np.stack([np.interp(s, known, row) for row in table])
    now = np.interp(s, length * np.arange(len(solution.ends)) / len(solution.durations), solution.ends)
    interval = np.searchsorted(solution.ends, np.mod(now + ahead, solution.time), side="right") - 1
    acted = _rescaled(solution, action)[:, np.minimum(interval, len(solution.durations) - 1)]

    then, to_states, to_actions = _driven_on(solution, action, corridor, dt, substeps)(s, lap, acted)
    rows = 1 + len(lap)
    at = np.array(then)[0]
    by_state = np.array(to_states).reshape(rows, PLACES, -1).transpose(1, 0, 2)
    by_action = np.array(to_actions).reshape(rows, PLACES, -1).transpose(1, 0, 2)
    slope = (np.roll(lap, -1, axis=1) - np.roll(lap, 1, axis=1)) * (PLACES / (2 * length))
    across = np.stack([np.interp(np.mod(at, length), s, row, period=length) for row in slope], axis=1)[:, :, None]
    A = by_state[:, 1:] - across * by_state[:, :1]
    B = by_action[:, 1:] - across * by_action[:, :1]
    size = _tolerances(solution, width)
    gains = _riccati(A, B, 1.0 / size**2, np.floor(np.mod(at, length) / length * PLACES).astype(int) % PLACES)
    return Feedback(lap.T, acted.T, gains, size)


def _rescaled(solution: Solution, action: Action) -> Array:
    """Return the lap's commands in the units of another action of the same kind."""
    steering = solution.commands[0] * (solution.action.steering_max / action.steering_max)
    drive = solution.commands[1]
    if action.integrated:
        drive = drive * (solution.action.rate_max / action.rate_max)
    return np.stack([steering, drive])


def _tolerances(solution: Solution, width: float) -> Array:
    top = float(solution.states[V_X].max())
    unit = {N: width, XI: 1.0, V_X: top, V_Y: top, YAW_RATE: top / width, OMEGA: top}
    size = np.full(len(solution.states), np.inf)
    for row, share in TOLERANCES.items():
        size[row] = share * unit[row]
    if solution.action.integrated:
        size[-1] = size[OMEGA]
    return size


def _driven_on(solution: Solution, action: Action, corridor: Corridor, dt: float, substeps: int) -> Any:
    """Return (s, z, u) → ((s, z) a control period later, its Jacobians by z and u), over all places at once."""
    vehicle, count = solution.vehicle, len(solution.states)
    margin = 0.2 * corridor.length
    grid = np.arange(-margin, corridor.length + margin, 0.02)
    curvature = casadi.interpolant("curvature", "linear", [grid], corridor.at(grid).curvature)
    z, u, kappa = casadi.SX.sym("z", count), casadi.SX.sym("u", 2), casadi.SX.sym("k")
    speed, rows = motion(vehicle, action, z, u, kappa)
    if action.integrated:
        rows[-1] = 0.0  # moved once, at the period's beginning
    rate = casadi.Function("rate", [z, u, kappa], [casadi.vertcat(speed, *rows)])

    s_0, z_0, held = casadi.MX.sym("s"), casadi.MX.sym("z", count), casadi.MX.sym("u", 2)
    y = casadi.vertcat(s_0, z_0)
    if action.integrated:
        moved = casadi.fmin(casadi.fmax(y[count] + held[1] * action.rate_max * dt, action.drive_min), action.drive_max)
        y = casadi.vertcat(y[:-1], moved)
    for _ in range(substeps):
        y = rk4(lambda now: rate(now[1:], held, curvature(now[0])), y, dt / substeps)
    outcome = [y, casadi.jacobian(y, z_0), casadi.jacobian(y, held)]
    return casadi.Function("driven_on", [s_0, z_0, held], outcome).map(PLACES)


def _riccati(A: Array, B: Array, Q: Array, after: NDArray[np.int64]) -> Array:
    """Return the gains (M, 2, Z) of the periodic problem; `after` is each place's next one, a period later."""
    R = np.diag([1.0 / share**2 for share in CORRECTIONS])
    P = np.repeat(np.diag(Q)[None], len(A), axis=0)
    for _ in range(ROUNDS):
        ahead = P[after]
        weighed = B.transpose(0, 2, 1) @ ahead
        gains = np.linalg.solve(R + weighed @ B, weighed @ A)
        last, P = P, np.diag(Q) + A.transpose(0, 2, 1) @ ahead @ (A - B @ gains)
        if np.abs(P - last).max() < SETTLED * np.abs(P).max():
            return np.asarray(gains)
    raise OptimumError("no feedback holds the car to its time-optimal lap")
