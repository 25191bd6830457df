"""What a predictive controller looks ahead over: K nodes of h seconds in the coordinates of a corridor's line.

States y = (s, z) with z as in `racerl.optimum.along`, commands u scaled to ± 1 and held over a node. A node is two
Runge–Kutta steps; its slopes come from the variational equation  Ḋ = ∂f/∂y D + ∂f/∂u  through the same steps. The cost

    −(s_K − s_0) + h Σ_k q_β(β_kin − β_dyn)² + q_δ(δ_ref − δ)² + q_ω(ω_ref − ω)² + q_n e_k

has the kinematic sideslip β_kin = atan(l_r tan δ/L), the sideslip β_dyn = atan(v_y/v_x), and e ≥ 0, by which a node is
beyond the boundaries, less `room` (m), or turned away from the line by more than `turn` (rad).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import casadi
import numpy as np
from numpy.typing import NDArray

from racerl.env.actions import Action, half_range, middle
from racerl.optimum.along import DELTA, OMEGA, V_X, V_Y, XI, N, motion, scales, size
from racerl.optimum.corridor import Corridor
from racerl.vehicle.compiler import build
from racerl.vehicle.vehicle import Vehicle

SUBSTEPS = 2
TABLE = 0.01  # m between the corridor's tabulated places

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Weights:
    """What a prediction costs, against a metre of progress."""

    sideslip: float  # q_β, 1/(rad² s)
    steering: float  # q_δ, 1/(rad² s)
    drive: float  # q_ω, s/m²
    boundary: float  # q_n, 1/(m s)
    room: float  # m
    turn: float  # rad, the largest |ξ|


@dataclass(frozen=True)
class Path:
    """States (K + 1, Y) and commands (K, 2) ahead."""

    y: Array
    u: Array


@dataclass(frozen=True)
class Slopes:
    """A path's nodes driven on, linearised."""

    after: Array  # (K, Y), where each node leads
    by_state: Array  # (K, Y, Y)
    by_command: Array  # (K, Y, 2)


class Table:
    """The corridor's line at even places round the lap: curvature and room, with their slopes along it."""

    def __init__(self, corridor: Corridor) -> None:
        self.length = corridor.length
        count = round(corridor.length / TABLE)
        self._spacing = corridor.length / count
        stretch = corridor.at(np.arange(count, dtype=np.float64) * self._spacing)
        values = np.stack([stretch.curvature, stretch.low, stretch.high])
        slopes = (np.roll(values, -1, axis=1) - np.roll(values, 1, axis=1)) / (2 * self._spacing)
        self._rows = np.ascontiguousarray(np.concatenate([values, slopes]).T)
        self._next = np.roll(self._rows, -1, axis=0)

    def at(self, s: Array) -> Array:
        """Return curvature, least and greatest n, and the slopes of the three, (6, M), at s (M,)."""
        place = np.mod(s, self.length) / self._spacing
        place = np.where(np.isfinite(place), place, 0.0)  # what is not finite shows in the states
        cell = np.minimum(place.astype(np.int64), len(self._rows) - 1)
        share = (place - cell)[:, None]
        found: Array = (self._rows[cell] * (1.0 - share) + self._next[cell] * share).T
        return found


class Horizon:
    """The problem on `nodes` nodes over `seconds`."""

    def __init__(
        self,
        vehicle: Vehicle,
        action: Action,
        corridor: Corridor,
        weights: Weights,
        nodes: int,
        seconds: float,
        compiled: bool = True,
    ) -> None:
        self.vehicle, self.action, self.weights = vehicle, action, weights
        self.nodes, self.period = nodes, seconds / nodes
        self.table = Table(corridor)
        self.states = 1 + size(vehicle, action)
        self.scale = np.concatenate([[1.0], scales(vehicle, action)])
        self.compiled = compiled
        self._rates = {count: self._rate(count) for count in (1, nodes)}
        self._residual = self.cost_terms()

    def advance(self, y: Array, u: Array, seconds: float) -> Slopes:
        """Return where states (M, Y) with commands (M, 2) held lead; M is 1 or the number of nodes."""
        rate = self._rates[len(y)]
        h = seconds / SUBSTEPS
        at, by = y, np.zeros((len(y), self.states, self.states + 2))
        by[:, range(self.states), range(self.states)] = 1.0
        for _ in range(SUBSTEPS):
            k_1, d_1 = rate(at, u, by)
            k_2, d_2 = rate(at + h / 2 * k_1, u, by + h / 2 * d_1)
            k_3, d_3 = rate(at + h / 2 * k_2, u, by + h / 2 * d_2)
            k_4, d_4 = rate(at + h * k_3, u, by + h * d_3)
            at = at + h / 6 * (k_1 + 2 * (k_2 + k_3) + k_4)
            by = by + h / 6 * (d_1 + 2 * (d_2 + d_3) + d_4)
        return Slopes(at, by[:, :, : self.states], by[:, :, self.states :])

    def residuals(self, path: Path) -> tuple[Array, Array]:
        """Return the weighted residuals of all nodes but the last (K, R), and their slopes (K, R, Y + 2)."""
        values, slopes = (np.array(part) for part in self._residual(path.y[:-1].T, path.u.T))
        return values.T, slopes.reshape(len(values), self.nodes, -1).transpose(1, 0, 2)

    def beyond(self, path: Path) -> Array:
        """Return e of each node but the first and the last, (K − 1,)."""
        _, low, high, *_ = self.table.at(path.y[1:-1, 0])
        n, xi = path.y[1:-1, 1 + N], path.y[1:-1, 1 + XI]
        outside = np.maximum(n - high, low - n) + self.weights.room
        over: Array = np.maximum(0.0, np.maximum(outside, np.abs(xi) - self.weights.turn))
        return over

    def cost(self, path: Path) -> float:
        """Return the cost of a path."""
        values, _ = self.residuals(path)
        outside = self.weights.boundary * self.period * self.beyond(path).sum()
        return float(0.5 * (values**2).sum() + outside - (path.y[-1, 0] - path.y[0, 0]))

    def derivative(self, y: Any, u: Any, kappa: Any) -> Any:
        """Return CasADi's ẏ at a curvature."""
        speed, rows = motion(self.vehicle, self.action, y[1:], u, kappa)
        return casadi.vertcat(speed, *rows)

    def _rate(self, count: int) -> Callable[[Array, Array, Array], tuple[Array, Array]]:
        """Return (y (M, Y), u (M, 2), D (M, Y, Y + 2)) → ẏ and Ḋ."""
        y, u, kappa = casadi.SX.sym("y", self.states), casadi.SX.sym("u", 2), casadi.SX.sym("k", 2)
        f = self.derivative(y, u, kappa[0] + kappa[1] * y[0])  # κ about the state's own place, which is y[0] = 0
        slopes_of = casadi.densify(casadi.jacobian(f, casadi.vertcat(y, u)).T)
        function = casadi.Function("rate", [y, u, kappa], [f, slopes_of], {"cse": True})
        call = _Call(function.map(count), self.compiled)
        states, table = self.states, self.table

        def rate(at: Array, command: Array, by: Array) -> tuple[Array, Array]:
            kappa, _, _, slope, _, _ = table.at(at[:, 0])
            call.inputs[0][:], call.inputs[1][:] = at, command
            call.inputs[0][:, 0] = 0.0
            call.inputs[2][:, 0], call.inputs[2][:, 1] = kappa, slope
            values, flat = call()
            slopes = flat.reshape(count, states, states + 2)
            by_rate = slopes[:, :, :states] @ by
            by_rate[:, :, states:] += slopes[:, :, states:]
            return values.copy(), by_rate

        return rate

    def cost_terms(self) -> Any:
        """Return the function from y and u of all nodes, a column each, to residuals and their slopes."""
        y, u = casadi.SX.sym("y", self.states), casadi.SX.sym("u", 2)
        z, weights, vehicle = y[1:], self.weights, self.vehicle
        kinematic = casadi.atan(float(vehicle.l_r) / float(vehicle.wheelbase) * casadi.tan(z[DELTA]))
        terms = [
            (weights.sideslip, kinematic - casadi.atan2(z[V_Y], z[V_X])),
            (weights.steering, u[0] * self.action.steering_max - z[DELTA]),
        ]
        held = middle(self.action) + half_range(self.action) * u[1]
        terms.append((weights.drive, (z[-1] if self.action.integrated else held) - z[OMEGA]))
        r = casadi.vertcat(*(np.sqrt(2 * self.period * weight) * term for weight, term in terms))
        slopes = casadi.jacobian(r, casadi.vertcat(y, u))
        return casadi.Function("residuals", [y, u], [r, casadi.densify(slopes)]).map(self.nodes)


class _Call:
    """A mapped CasADi function on arrays that it reads and writes in place, compiled where there is a compiler."""

    def __init__(self, function: Any, compiled: bool) -> None:
        library = build(_code(function)) if compiled else None
        function = casadi.external(function.name(), library._name) if library else function
        self.inputs = [np.zeros(function.size_in(i)[::-1]) for i in range(function.n_in())]
        self.outputs = [np.zeros(function.size_out(i)[::-1]) for i in range(function.n_out())]
        self._buffer, self._evaluate = function.buffer()
        for i, array in enumerate(self.inputs):
            self._buffer.set_arg(i, array.data)
        for i, array in enumerate(self.outputs):
            self._buffer.set_res(i, array.data)

    def __call__(self) -> list[Array]:
        """Return the outputs, which the next call overwrites."""
        self._evaluate()
        return self.outputs


def _code(function: Any) -> str:
    """Return the C code of a function."""
    generator = casadi.CodeGenerator(f"{function.name()}.c")
    generator.add(function)
    return str(generator.dump())
