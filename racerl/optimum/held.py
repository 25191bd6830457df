"""The minimum-time lap with commands held over control periods, as a policy drives it.

The race's own Runge–Kutta steps are the constraints: M = K·substeps states X_j in Cartesian coordinates, each with its
place (s_j, n_j) in the corridor. All K periods last h, which is minimised; K is chosen so that h is as near as possible
to the race's period, which a lap is no multiple of.
"""

from dataclasses import dataclass
from typing import Any

import casadi
import numpy as np
from numpy.typing import NDArray

from racerl.optimum.along import N
from racerl.optimum.collocation import MOST_TURN, Solution, minimise
from racerl.optimum.corridor import Corridor
from racerl.vehicle.integrate import rk4
from racerl.vehicle.ops import CasadiOps
from racerl.vehicle.vehicle import STATE, Vehicle

TABLE = 0.02  # m between the corridor's tabulated places
BEYOND = 0.1  # of the lap, tabulated before and after it
SLOWEST = 0.05  # m/s
YAW, V_X = STATE.index("yaw"), STATE.index("v_x")

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Held:
    """A lap of K control periods."""

    period: float  # s
    substeps: int  # integration steps per period
    states: Array  # (S, M + 1) after each integration step; the last is the first, a lap later
    references: Array  # (2, K): steering in rad, drive in m/s or A

    @property
    def time(self) -> float:
        """The lap time in s."""
        return self.period * self.references.shape[1]


def hold(corridor: Corridor, solution: Solution, period: float, substeps: int) -> Held:
    """Return the fastest lap near a solution with references held for about `period` seconds."""
    vehicle, action = solution.vehicle, solution.action
    count = max(1, round(solution.time / period))
    steps = count * substeps
    states, places, references = _sample(solution, count, substeps)

    X, P = casadi.MX.sym("X", len(states), steps), casadi.MX.sym("P", 2, steps)
    U, h = casadi.MX.sym("U", 2, count), casadi.MX.sym("h")
    lap = casadi.DM([solution.turn if row == YAW else 0.0 for row in range(len(states))])
    after = casadi.horzcat(X[:, 1:], X[:, 0] + lap)
    held = casadi.horzcat(*[U[:, k] for k in range(count) for _ in range(substeps)])
    moved = _step(vehicle).map(steps)(X, held, casadi.repmat(h / substeps, 1, steps))
    x, y, yaw, right, left = casadi.vertsplit(_geometry(corridor).map(steps)(P))
    turned = (X[YAW, :] - yaw).T
    equal = casadi.vertcat(casadi.vec(moved - after), casadi.vec(X[:2, :] - casadi.vertcat(x, y)))
    positive = [right.T, left.T, MOST_TURN - turned, MOST_TURN + turned]
    if action.integrated:
        change = (U[1, :] - casadi.horzcat(U[1, -1], U[1, :-1])).T
        positive += [action.rate_max * h - change, action.rate_max * h + change]

    least, most = np.full(states.shape, -np.inf), np.full(states.shape, np.inf)
    least[V_X] = SLOWEST
    margin, ones = BEYOND * corridor.length, np.ones(count)
    parts: list[tuple[Any, Array, Array, Array]] = [
        (X, states, least, most),
        (P, places, places - margin, places + margin),
        (
            U,
            references,
            np.outer([-action.steering_max, action.drive_min], ones),
            np.outer([action.steering_max, action.drive_max], ones),
        ),
        (h, np.full((1, 1), solution.time / count), np.full((1, 1), period / 2), np.full((1, 1), 2 * period)),
    ]
    unknowns = casadi.vertcat(*(casadi.vec(part[0]) for part in parts))
    start, low, high = (np.concatenate([part[i].T.ravel() for part in parts]) for i in (1, 2, 3))
    found = minimise(h * count, unknowns, equal, start, low, high, casadi.vertcat(*positive))
    best = np.array(casadi.Function("X", [unknowns], [casadi.horzcat(X, X[:, 0] + lap)])(found))
    used = np.array(casadi.Function("U", [unknowns], [U])(found))
    return Held(float(found[-1]), substeps, best, used)


def _sample(solution: Solution, count: int, substeps: int) -> tuple[Array, Array, Array]:
    """Return states (S, M), places (2, M) and references (2, K) of a solution at even times."""
    table = np.concatenate([solution.cartesian, solution.stretch.s[None], solution.states[N, None]])
    first = table[:, -1:].copy()
    first[YAW] -= solution.turn
    first[-2] = 0.0
    t = np.concatenate([[0.0], solution.times])
    even = np.arange(count * substeps) * (solution.time / (count * substeps))
    rows = np.stack([np.interp(even, t, row) for row in np.concatenate([first, table], axis=1)])
    middles = (np.arange(count) + 0.5) * (solution.time / count)
    interval = np.clip(np.searchsorted(solution.ends, middles) - 1, 0, len(solution.durations) - 1)
    return rows[:-2], rows[-2:], solution.references[:, interval]


def _step(vehicle: Vehicle) -> Any:
    """Return (X, U, seconds) → X after one Runge–Kutta step."""
    x, u, h = casadi.SX.sym("x", len(vehicle.states)), casadi.SX.sym("u", 2), casadi.SX.sym("h")
    return casadi.Function(
        "step", [x, u, h], [rk4(lambda now: vehicle.derivative(now, u, CasadiOps()), x, h)], {"cse": True}
    )


def _geometry(corridor: Corridor) -> Any:
    """Return (s, n) → (x, y in m, yaw of the line in rad, room to the right, room to the left in m)."""
    margin = BEYOND * corridor.length
    s = np.arange(-2 * margin, corridor.length + 2 * margin, TABLE)
    stretch = corridor.at(s)
    smooth = {name: casadi.interpolant(name, "bspline", [s], getattr(stretch, name)) for name in ("x", "y", "yaw")}
    bound = {name: casadi.interpolant(name, "linear", [s], getattr(stretch, name)) for name in ("low", "high")}
    place = casadi.MX.sym("place", 2)
    at, n = place[0], place[1]
    x = smooth["x"](at) - n * casadi.sin(smooth["yaw"](at))
    y = smooth["y"](at) + n * casadi.cos(smooth["yaw"](at))
    rows = casadi.vertcat(x, y, smooth["yaw"](at), n - bound["low"](at), bound["high"](at) - n)
    return casadi.Function("geometry", [place], [rows])
