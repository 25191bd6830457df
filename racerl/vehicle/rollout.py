"""Rollouts of one car over many windows at once, with the sensitivities that a fit needs.

A window is a stretch of T control intervals from its own initial state. The sensitivities X = ∂x/∂(θ, x_0) of the
state with respect to the parameters and the initial state are integrated beside it,

    Ẋ = ∂f/∂x X + [∂f/∂θ, 0],   X(0) = [0, 1],

by the same Runge–Kutta steps, so that they are the exact derivatives of the discrete rollout. With the weighted
residuals e = w (x − y) of the observed states, each window returns its share of the normal equations

    H = Σ (∂e/∂z)ᵀ (∂e/∂z),   g = Σ (∂e/∂z)ᵀ e,   z = (θ, x_0).

Every window has parameters of its own where they are given as (P, W), so that windows × parameter sets (an effect whose
strength is a parameter on in some, off in others) are one call, and nothing is compiled anew inside a fit.

Derivatives come from CasADi's differentiation of `Vehicle.derivative`; the generated C runs in double precision over 8
windows at a time, on several threads, with results that do not depend on their number. Without a compiler torch does
the same by automatic differentiation, far more slowly.
"""

import ctypes
import dataclasses
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from racerl.vehicle.actuator import Instant
from racerl.vehicle.codegen import build, precision, statements
from racerl.vehicle.integrate import rk4
from racerl.vehicle.ops import TORCH, CasadiOps
from racerl.vehicle.parameter import replace_values, values
from racerl.vehicle.vehicle import STATE, Vehicle

Array = NDArray[np.float64]
LANES = 8
CHUNK = 64  # windows per call of the compiled kernel

TEMPLATE = """
#include <math.h>
#include <string.h>
{precision}
#define LANES {lanes}
#define S {states}
#define A {active}
#define P {parameters}
#define D (P + A)
#define C {observed}
typedef real lane[LANES];
static const int ACTIVE[A] = {{{active_rows}}};
static const int OBSERVED[C] = {{{observed_rows}}};

static inline void derivative(const lane *restrict x, const lane *restrict u, const lane *restrict p,
                              lane *restrict k) {{
    #pragma omp simd
    for (int l = 0; l < LANES; l++) {{
{derivative}
    }}
}}

static inline void linearise(const lane *restrict x, const lane *restrict u, const lane *restrict p,
                             lane *restrict k, lane *restrict a, lane *restrict b) {{
    #pragma omp simd
    for (int l = 0; l < LANES; l++) {{
{linearised}
    }}
}}

/* K = (df/dx) X + [df/dp, 0] */
static inline void spread(const lane *restrict a, const lane *restrict b, lane (*restrict X)[D],
                          lane (*restrict K)[D]) {{
    for (int d = 0; d < D; d++) {{
        #pragma omp simd
        for (int l = 0; l < LANES; l++) {{
{product}
        }}
    }}
    #pragma omp simd
    for (int l = 0; l < LANES; l++) {{
{direct}
    }}
}}

static void along(const lane *restrict x, const lane *restrict k, real h, lane *restrict y, int rows) {{
    for (int i = 0; i < rows; i++)
        for (int l = 0; l < LANES; l++) y[i][l] = x[i][l] + h * k[i][l];
}}

static void gather(lane *restrict sum, const lane *restrict k, real h, int rows) {{
    for (int i = 0; i < rows; i++)
        for (int l = 0; l < LANES; l++) sum[i][l] += h * k[i][l];
}}

#define LOAD(target, source, rows) \\
    for (int i = 0; i < (rows); i++) for (int l = 0; l < LANES; l++) target[i][l] = (source)[i * n + window[l]]

void simulate(const real *x_0, const real *inputs, const real *parameters, real *out, long n, long intervals,
              long steps, real h) {{
    for (long first = 0; first < n; first += LANES) {{
        lane x[S], y[S], sum[S], k[S], u[2], p[P + 1];
        long window[LANES];
        for (int l = 0; l < LANES; l++) window[l] = first + l < n ? first + l : n - 1;
        LOAD(x, x_0, S);
        LOAD(p, parameters, P);
        for (long t = 0; t <= intervals; t++) {{
            for (int l = 0; l < LANES && first + l < n; l++)
                for (int i = 0; i < S; i++) out[(t * S + i) * n + first + l] = x[i][l];
            if (t == intervals) break;
            LOAD(u, inputs + t * 2 * n, 2);
            for (long step = 0; step < steps; step++) {{
                memcpy(sum, x, sizeof x);
                derivative(x, u, p, k); gather(sum, k, h / 6, S); along(x, k, h / 2, y, S);
                derivative(y, u, p, k); gather(sum, k, h / 3, S); along(x, k, h / 2, y, S);
                derivative(y, u, p, k); gather(sum, k, h / 3, S); along(x, k, h, y, S);
                derivative(y, u, p, k); gather(sum, k, h / 6, S);
                memcpy(x, sum, sizeof x);
            }}
        }}
    }}
}}

void accumulate(const real *x_0, const real *inputs, const real *parameters, const real *measured, const real *weight,
                real *H_out, real *g_out, real *squares, long n, long intervals, long steps, real h) {{
    static _Thread_local lane X[A][D], Y[A][D], SUM[A][D], K[A][D], H[D][D], g[D];
    for (long first = 0; first < n; first += LANES) {{
        lane x[S], y[S], sum[S], k[S], u[2], p[P + 1], a[{jacobian} + 1], b[{gradient} + 1];
        lane w[C], m[C], e[C], q[C];
        long window[LANES];
        for (int l = 0; l < LANES; l++) window[l] = first + l < n ? first + l : n - 1;
        LOAD(x, x_0, S);
        LOAD(w, weight, C);
        LOAD(p, parameters, P);
        memset(X, 0, sizeof X); memset(H, 0, sizeof H); memset(g, 0, sizeof g); memset(q, 0, sizeof q);
        for (int i = 0; i < A; i++) for (int l = 0; l < LANES; l++) X[i][P + i][l] = 1;
        for (long t = 0; t <= intervals; t++) {{
            LOAD(m, measured + t * C * n, C);
            for (int c = 0; c < C; c++)
                for (int l = 0; l < LANES; l++) {{
                    e[c][l] = w[c][l] * (x[ACTIVE[OBSERVED[c]]][l] - m[c][l]);
                    q[c][l] += e[c][l] * e[c][l];
                }}
            for (int i = 0; i < D; i++) {{
                lane J[C];
                for (int c = 0; c < C; c++)
                    for (int l = 0; l < LANES; l++) {{
                        J[c][l] = w[c][l] * w[c][l] * X[OBSERVED[c]][i][l];
                        g[i][l] += w[c][l] * X[OBSERVED[c]][i][l] * e[c][l];
                    }}
                for (int j = 0; j <= i; j++)
                    for (int l = 0; l < LANES; l++) {{
                        real total = H[i][j][l];
                        for (int c = 0; c < C; c++) total += J[c][l] * X[OBSERVED[c]][j][l];
                        H[i][j][l] = total;
                    }}
            }}
            if (t == intervals) break;
            LOAD(u, inputs + t * 2 * n, 2);
            for (long step = 0; step < steps; step++) {{
                memcpy(sum, x, sizeof x); memcpy(SUM, X, sizeof X);
                linearise(x, u, p, k, a, b); spread(a, b, X, K);
                gather(sum, k, h / 6, S); along(x, k, h / 2, y, S);
                gather(&SUM[0][0], &K[0][0], h / 6, A * D); along(&X[0][0], &K[0][0], h / 2, &Y[0][0], A * D);
                linearise(y, u, p, k, a, b); spread(a, b, Y, K);
                gather(sum, k, h / 3, S); along(x, k, h / 2, y, S);
                gather(&SUM[0][0], &K[0][0], h / 3, A * D); along(&X[0][0], &K[0][0], h / 2, &Y[0][0], A * D);
                linearise(y, u, p, k, a, b); spread(a, b, Y, K);
                gather(sum, k, h / 3, S); along(x, k, h, y, S);
                gather(&SUM[0][0], &K[0][0], h / 3, A * D); along(&X[0][0], &K[0][0], h, &Y[0][0], A * D);
                linearise(y, u, p, k, a, b); spread(a, b, Y, K);
                gather(sum, k, h / 6, S); gather(&SUM[0][0], &K[0][0], h / 6, A * D);
                memcpy(x, sum, sizeof x); memcpy(X, SUM, sizeof X);
            }}
        }}
        for (int l = 0; l < LANES && first + l < n; l++) {{
            long at = first + l;
            for (int i = 0; i < D; i++) {{
                g_out[at * D + i] = g[i][l];
                for (int j = 0; j < D; j++) H_out[(at * D + i) * D + j] = j <= i ? H[i][j][l] : H[j][i][l];
            }}
            for (int c = 0; c < C; c++) squares[at * C + c] = q[c][l];
        }}
    }}
}}
"""


@dataclass(frozen=True)
class Windows:
    """Measured stretches of driving, all of T intervals of dt seconds.

    `initial` (S, W): full state at the start. `inputs` (T, 2, W): what drives the car, held over each interval.
    `measured` (T + 1, C, W): the observed states. `weight` (C, W): of their residuals; 0 leaves a channel out.
    """

    initial: Array
    inputs: Array
    measured: Array
    weight: Array
    dt: float

    @property
    def count(self) -> int:
        """Number of windows W."""
        return self.initial.shape[1]

    def take(self, index: Any) -> "Windows":
        """Return some of the windows."""
        initial, inputs, measured, weight = (
            np.ascontiguousarray(part[..., index]) for part in (self.initial, self.inputs, self.measured, self.weight)
        )
        return Windows(initial, inputs, measured, weight, self.dt)


@dataclass(frozen=True)
class NormalEquations:
    """Shares of the windows: H (W, D, D), g (W, D), Σe² per channel (W, C); z = (parameters, active initial states)."""

    H: Array
    g: Array
    squares: Array


def drive_by(vehicle: Vehicle, *, measured_steering: bool, measured_speed: bool) -> Vehicle:
    """Return the car whose steering angle or wheel speed is given, not simulated."""
    changes: dict[str, Any] = {}
    if measured_steering:
        changes["steering"] = Instant()
    if measured_speed:
        changes["drive"] = Instant()
    return dataclasses.replace(vehicle, **changes)


class Rollout:
    """The rollouts of one vehicle structure: `names` are the parameters that vary, `observed` the states compared.

    `active` are the states that the observed ones depend on; only their initial values matter.
    """

    def __init__(self, vehicle: Vehicle, names: Sequence[str], observed: Sequence[str], step: float = 0.01) -> None:
        self.vehicle, self.names, self.observed, self.step = vehicle, list(names), list(observed), step
        self.active = _active(vehicle, self.observed)
        self._library = build(source(vehicle, self.names, self.observed, self.active))
        self.compiled = self._library is not None

    @property
    def size(self) -> int:
        """Number of unknowns of one window, D = P + A."""
        return len(self.names) + len(self.active)

    def nominal(self) -> Array:
        """Return the vehicle's own values of the varying parameters, (P,)."""
        table = values(self.vehicle)
        return np.array([float(table[name]) for name in self.names])

    def simulate(self, parameters: Array, windows: Windows, threads: int = 1) -> Array:
        """Return the states (T + 1, S, W) of all windows, for parameters (P,) or (P, W)."""
        parameters = _per_window(parameters, windows)
        steps, h = self.steps(windows.dt)
        intervals, states = len(windows.inputs), len(self.vehicle.states)
        if self._library is None:
            return _simulate_torch(self, torch.as_tensor(np.array(parameters)), windows, steps, h).numpy()

        def run(part: Windows, parameters: Array) -> Array:
            out = np.empty((intervals + 1, states, part.count))
            _call(
                self._library, "simulate", [part.initial, part.inputs, parameters, out], part.count, intervals, steps, h
            )
            return out

        parts = _in_chunks(run, windows, parameters, threads)
        return np.concatenate(parts, axis=2)

    def accumulate(self, parameters: Array, windows: Windows, threads: int = 1) -> NormalEquations:
        """Return every window's normal equations at parameters (P,) or (P, W) and the windows' initial states."""
        parameters = _per_window(parameters, windows)
        steps, h = self.steps(windows.dt)
        intervals, channels, size = len(windows.inputs), len(self.observed), self.size
        if self._library is None:
            return _accumulate_torch(self, parameters, windows, steps, h)

        def run(part: Windows, parameters: Array) -> tuple[Array, Array, Array]:
            out = np.empty((part.count, size, size)), np.empty((part.count, size)), np.empty((part.count, channels))
            given = [part.initial, part.inputs, parameters, part.measured, part.weight]
            _call(self._library, "accumulate", [*given, *out], part.count, intervals, steps, h)
            return out

        parts = _in_chunks(run, windows, parameters, threads)
        return NormalEquations(*(np.concatenate(part) for part in zip(*parts, strict=True)))

    def steps(self, dt: float) -> tuple[int, float]:
        """Return how many Runge–Kutta steps one interval takes, and their length in s."""
        steps = max(1, round(np.ceil(dt / self.step - 1e-6)))
        return steps, dt / steps


def _per_window(parameters: Array, windows: Windows) -> Array:
    """Return parameters (P, W) from those, or from (P,) for all windows."""
    columns = parameters if parameters.ndim == 2 else parameters[:, None]
    return np.broadcast_to(columns, (len(parameters), windows.count))


def _in_chunks(run: Any, windows: Windows, parameters: Array, threads: int) -> list[Any]:
    """Call `run` on chunks of windows, in order; the compiled kernel lets other threads work meanwhile."""
    parts = [slice(first, first + CHUNK) for first in range(0, windows.count, CHUNK)]
    chunks = [(windows.take(part), parameters[:, part]) for part in parts]
    if threads == 1 or len(chunks) == 1:
        return [run(*chunk) for chunk in chunks]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(lambda chunk: run(*chunk), chunks))


def _call(library: Any, name: str, arrays: Sequence[Array], count: int, intervals: int, steps: int, h: float) -> None:
    contiguous = [np.ascontiguousarray(array, dtype=np.float64) for array in arrays]
    function = getattr(library, name)
    function.restype = None
    function.argtypes = [ctypes.c_void_p] * len(arrays) + [ctypes.c_long] * 3 + [ctypes.c_double]
    function(*(array.ctypes.data for array in contiguous), count, intervals, steps, h)


def _linearisation(vehicle: Vehicle, names: Sequence[str]) -> tuple[Any, Any, Any, Any, Any, Any]:
    """Return CasADi's x, u, p, f(x, u, p), ∂f/∂x and ∂f/∂p."""
    import casadi

    ops = CasadiOps()
    x, u, p = casadi.SX.sym("x", len(vehicle.states)), casadi.SX.sym("u", 2), casadi.SX.sym("p", len(names))
    car = replace_values(vehicle, dict(zip(names, ops.unstack(p) if names else [], strict=True)))
    f = car.derivative(x, u, ops)
    return x, u, p, f, casadi.jacobian(f, x), casadi.jacobian(f, p)


def fastest_rate(vehicle: Vehicle, states: Array) -> float:
    """Return the largest |eigenvalue| of ∂f/∂x over given states (S, N), in 1/s; RK4 is stable while h·|λ| < 2.7."""
    import casadi

    x, u, p, _, f_x, _ = _linearisation(vehicle, [])
    jacobian = casadi.Function("jacobian", [x, u, p], [f_x]).map(states.shape[1])
    blocks = np.asarray(jacobian(states, states[[STATE.index("delta"), STATE.index("omega")]], []))
    square = blocks.reshape(len(states), states.shape[1], len(states)).transpose(1, 0, 2)
    return float(np.abs(np.linalg.eigvals(square)).max())


def settle(vehicle: Vehicle, windows: Windows) -> None:
    """Set the effects' own initial states to where they rest in the measured motion: one Newton step on their rates.

    Exact for rates that are linear in those states, as lags are; states that never rest (clocks) stay as they are.
    """
    import casadi

    if len(vehicle.states) == len(STATE):
        return
    own = slice(len(STATE), len(vehicle.states))
    x, u, p, f, f_x, _ = _linearisation(vehicle, [])
    count = windows.count
    rates = casadi.Function("rates", [x, u, p], [f[own], f_x[own, own]]).map(count)
    f_own, f_xx = (np.asarray(part) for part in rates(windows.initial, windows.inputs[0], []))
    blocks = f_xx.reshape(len(f_own), count, len(f_own)).transpose(1, 0, 2)
    solvable = np.abs(np.linalg.det(blocks)) > 1e-9
    step = np.linalg.solve(blocks[solvable], f_own.T[solvable][:, :, None])[:, :, 0]
    windows.initial[own, solvable] -= step.T


def _active(vehicle: Vehicle, observed: Sequence[str]) -> list[str]:
    """Return the observed states and all that they depend on, in the vehicle's order."""
    *_, jacobian, _ = _linearisation(vehicle, [])
    rows, columns = jacobian.sparsity().get_triplet()
    states = vehicle.states
    wanted = {states.index(name) for name in observed}
    while True:
        more = {j for i, j in zip(rows, columns, strict=True) if i in wanted} - wanted
        if not more:
            return [name for i, name in enumerate(states) if i in wanted]
        wanted |= more


def source(vehicle: Vehicle, names: Sequence[str], observed: Sequence[str], active: Sequence[str]) -> str:
    """Return the C source of the rollout and its sensitivities."""
    import casadi

    x, u, p, f, f_x, f_p = _linearisation(vehicle, names)
    rows = [vehicle.states.index(name) for name in active]
    f_x, f_p = f_x[rows, rows], f_p[rows, :]
    a, b = casadi.vertcat(*f_x.nonzeros()), casadi.vertcat(*f_p.nonzeros())
    outputs = casadi.cse([f, a, b])
    plain = casadi.Function("derivative", [x, u, p], [f])
    linearised = casadi.Function("linearised", [x, u, p], outputs)
    products: list[list[str]] = [[] for _ in rows]
    for index, (i, j) in enumerate(zip(*f_x.sparsity().get_triplet(), strict=True)):
        products[i].append(f"a[{index}][l] * X[{j}][d][l]")
    direct = [
        f"        K[{i}][{j}][l] += b[{index}][l];"
        for index, (i, j) in enumerate(zip(*f_p.sparsity().get_triplet(), strict=True))
    ]
    return TEMPLATE.format(
        precision=precision("double"),
        lanes=LANES,
        states=len(vehicle.states),
        active=len(active),
        parameters=len(names),
        observed=len(observed),
        active_rows=", ".join(map(str, rows)),
        observed_rows=", ".join(str(active.index(name)) for name in observed),
        derivative=statements(plain, ("x", "u", "p"), ("k",)),
        linearised=statements(linearised, ("x", "u", "p"), ("k", "a", "b")),
        product="\n".join(
            f"            K[{i}][d][l] = {' + '.join(terms) or '0'};" for i, terms in enumerate(products)
        ),
        direct="\n".join(direct),
        jacobian=f_x.nnz(),
        gradient=f_p.nnz(),
    )


def _simulate_torch(rollout: Rollout, parameters: torch.Tensor, windows: Windows, steps: int, h: float) -> torch.Tensor:
    """Return the states (T + 1, S, W), differentiable in the parameters."""
    return roll_out(
        replace_values(rollout.vehicle, dict(zip(rollout.names, parameters.unbind(0), strict=True))),
        torch.as_tensor(windows.initial),
        torch.as_tensor(windows.inputs),
        steps,
        h,
    )


def roll_out(vehicle: Vehicle, initial: torch.Tensor, inputs: torch.Tensor, steps: int, h: float) -> torch.Tensor:
    """Return the states (T + 1, S, W) on torch, differentiable in everything; inputs are (T, 2, W)."""
    states = [initial]
    for command in inputs:
        state = states[-1]
        for _ in range(steps):
            state = rk4(vehicle, state, command, h, TORCH)
        states.append(state)
    return torch.stack(states)


def _accumulate_torch(rollout: Rollout, parameters: Array, windows: Windows, steps: int, h: float) -> NormalEquations:
    """Form the normal equations by forward-mode differentiation, one unknown at a time."""
    active = [rollout.vehicle.states.index(name) for name in rollout.active]
    observed = [rollout.vehicle.states.index(name) for name in rollout.observed]
    theta, initial = torch.as_tensor(np.array(parameters)), torch.as_tensor(windows.initial)
    weight, measured = torch.as_tensor(windows.weight), torch.as_tensor(windows.measured)
    inputs = torch.as_tensor(windows.inputs)

    def residual(theta: torch.Tensor, initial: torch.Tensor) -> torch.Tensor:
        car = replace_values(rollout.vehicle, dict(zip(rollout.names, theta.unbind(0), strict=True)))
        return weight * (roll_out(car, initial, inputs, steps, h)[:, observed] - measured)

    unknowns = torch.eye(rollout.size, dtype=theta.dtype)
    d_theta = unknowns[:, : len(theta), None].expand(-1, -1, windows.count)
    d_initial = torch.zeros(rollout.size, *initial.shape, dtype=theta.dtype)
    d_initial[:, active] = unknowns[:, len(theta) :, None]

    def along(d_theta: torch.Tensor, d_initial: torch.Tensor) -> torch.Tensor:
        tangent: torch.Tensor = torch.func.jvp(residual, (theta, initial), (d_theta, d_initial))[1]
        return tangent

    e = residual(theta, initial)  # (T + 1, C, W)
    J = torch.func.vmap(along)(d_theta, d_initial)  # (D, T + 1, C, W)
    return NormalEquations(
        torch.einsum("itcw,jtcw->wij", J, J).numpy(),
        torch.einsum("itcw,tcw->wi", J, e).numpy(),
        (e**2).sum(dim=0).T.numpy(),
    )
