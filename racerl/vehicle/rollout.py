"""Rollouts of one car over many windows at once, with the sensitivities that a fit needs.

A window is a stretch of T control intervals from its own initial state. The sensitivities X = ∂x/∂(θ, x_0) of the
state with respect to the parameters and the initial state are integrated beside it,

    Ẋ = ∂f/∂x X + [∂f/∂θ, 0],   X(0) = [0, 1],

by the same Runge–Kutta steps, so that they are the exact derivatives of the discrete rollout. With the weighted
residuals e = w (x − y) of the observed states, each window returns its share of the normal equations

    H = Σ (∂e/∂z)ᵀ (∂e/∂z),   g = Σ (∂e/∂z)ᵀ e,   z = (θ, x_0).

Every window has parameters of its own where they are given as (P, W), so that windows × parameter sets (an effect whose
strength is a parameter on in some, off in others) are one call, and nothing is compiled anew inside a fit.

Derivatives come from CasADi's differentiation of `Vehicle.derivative`; the generated C runs in double precision over 16
windows at a time, on several threads, with results that do not depend on their number. Without a compiler torch does
the same by automatic differentiation, far more slowly.
"""

import ctypes
import dataclasses
import itertools
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from racerl.vehicle.actuator import Given
from racerl.vehicle.codegen import precision, statements
from racerl.vehicle.compiler import QUICK, build
from racerl.vehicle.integrate import rk4
from racerl.vehicle.ops import TORCH, CasadiOps, Ops, symbolic
from racerl.vehicle.parameter import replace_values, values
from racerl.vehicle.vehicle import STATE, Vehicle

Array = NDArray[np.float64]
LANES = 16
INPUTS = ("delta", "omega")  # what drives the car, measured where its actuator is given
UNDO = 3  # passes of the fixed-point iteration that inverts a sensor; each takes its error to its square or better
CHUNK = 32  # windows per call of the compiled kernel

_threads: ContextVar[int] = ContextVar("threads", default=1)

TEMPLATE = """
#include <math.h>
#include <string.h>
{precision}
#define LANES {lanes}
#define S {states}
#define A {active}
#define P {parameters}
#define F {free}
#define DMAX (F + A)
#define C {observed}
#define U {inputs}
typedef real lane[LANES];

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

static inline void sight(const lane *restrict x, const lane *restrict p, lane *restrict y, lane *restrict a,
                         lane *restrict b) {{
    #pragma omp simd
    for (int l = 0; l < LANES; l++) {{
{sight}
    }}
}}

/* a sparse matrix's entry of a parameter, added to the column that the parameter has, if it has one */
#define SEE(row, parameter, entry) \\
    if (slot[parameter] >= 0) \\
        for (int l = 0; l < LANES; l++) K[row][slot[parameter]][l] += b[entry][l];
#define PUSH(row, parameter, entry) \\
    if (slot[parameter] >= 0 && on[row]) \\
        for (int l = 0; l < LANES; l++) {{ \\
            sum[row][slot[parameter]][l] += g * b[entry][l]; \\
            Y[row][slot[parameter]][l] += h * b[entry][l]; \\
        }}

/* Z = (dh/dx) X + [dh/dp, 0] */
static inline void look(const lane *restrict a, const lane *restrict b, const int *slot, long D,
                        lane (*restrict X)[D], lane (*restrict K)[D]) {{
    for (int d = 0; d < D; d++) {{
        #pragma omp simd
        for (int l = 0; l < LANES; l++) {{
{seen}
        }}
    }}
{seen_direct}
}}

/* K = (df/dx) X + [df/dp, 0]; sum += g K, Y = base + h K; rows that are off stay as they are */
static inline void spread(const lane *restrict a, const lane *restrict b, const int *slot, const int *on, long D,
                          lane (*X)[D], lane (*base)[D], lane (*restrict sum)[D], real g,
                          lane (*restrict Y)[D], real h) {{
    lane K[D];
{product}
{direct}
}}

static void along(const lane *restrict x, const lane *restrict k, real h, lane *restrict y, int rows) {{
    for (int i = 0; i < rows; i++)
        #pragma omp simd
        for (int l = 0; l < LANES; l++) y[i][l] = x[i][l] + h * k[i][l];
}}

static void gather(lane *restrict sum, const lane *restrict k, real h, int rows) {{
    for (int i = 0; i < rows; i++)
        #pragma omp simd
        for (int l = 0; l < LANES; l++) sum[i][l] += h * k[i][l];
}}

#define LOAD(target, source, rows) \\
    for (int i = 0; i < (rows); i++) for (int l = 0; l < LANES; l++) target[i][l] = (source)[i * n + window[l]]

static void advance(lane *restrict x, const lane *restrict u, const lane *restrict p, long steps, real h) {{
    lane y[S], sum[S], k[S];
    for (long step = 0; step < steps; step++) {{
        memcpy(sum, x, sizeof sum);
        derivative(x, u, p, k); gather(sum, k, h / 6, S); along(x, k, h / 2, y, S);
        derivative(y, u, p, k); gather(sum, k, h / 3, S); along(x, k, h / 2, y, S);
        derivative(y, u, p, k); gather(sum, k, h / 3, S); along(x, k, h, y, S);
        derivative(y, u, p, k); gather(sum, k, h / 6, S);
        memcpy(x, sum, sizeof sum);
    }}
}}

void simulate(const real *x_0, const real *inputs, const real *parameters, real *out, long n, long intervals,
              long steps, real h) {{
    for (long first = 0; first < n; first += LANES) {{
        lane x[S], u[U], p[P + 1];
        long window[LANES];
        for (int l = 0; l < LANES; l++) window[l] = first + l < n ? first + l : n - 1;
        LOAD(x, x_0, S);
        LOAD(p, parameters, P);
        for (long t = 0; t <= intervals; t++) {{
            for (int l = 0; l < LANES && first + l < n; l++)
                for (int i = 0; i < S; i++) out[(t * S + i) * n + first + l] = x[i][l];
            if (t == intervals) break;
            LOAD(u, inputs + t * U * n, U);
            advance(x, u, p, steps, h);
        }}
    }}
}}

/* squared weighted errors, summed over the samples of each window */
void squares(const real *x_0, const real *inputs, const real *parameters, const real *measured, const real *weight,
             real *out, long n, long intervals, long steps, real h) {{
    for (long first = 0; first < n; first += LANES) {{
        lane x[S], u[U], p[P + 1], w[C], m[C], v[C], q[C], a[{sight_jacobian} + 1], b[{sight_gradient} + 1];
        long window[LANES];
        for (int l = 0; l < LANES; l++) window[l] = first + l < n ? first + l : n - 1;
        LOAD(x, x_0, S);
        LOAD(w, weight, C);
        LOAD(p, parameters, P);
        memset(q, 0, sizeof q);
        for (long t = 0; t <= intervals; t++) {{
            LOAD(m, measured + t * C * n, C);
            sight(x, p, v, a, b);
            for (int c = 0; c < C; c++)
                #pragma omp simd
                for (int l = 0; l < LANES; l++) {{
                    real e = w[c][l] * (v[c][l] - m[c][l]);
                    q[c][l] += e * e;
                }}
            if (t == intervals) break;
            LOAD(u, inputs + t * U * n, U);
            advance(x, u, p, steps, h);
        }}
        for (int l = 0; l < LANES && first + l < n; l++)
            for (int c = 0; c < C; c++) out[(first + l) * C + c] = q[c][l];
    }}
}}

/* `slot` (F + A): the column of each parameter and initial state among the D that are asked for, or -1;
   `on` (A): whether anything that is seen depends on a state */
void accumulate(const real *x_0, const real *inputs, const real *parameters, const real *measured, const real *weight,
                real *H_out, real *g_out, real *squares, long n, long intervals, long steps, real h,
                const int *slot, long D, const int *on) {{
    static _Thread_local lane X_[A * DMAX], Y_[A * DMAX], W_[A * DMAX], SUM_[A * DMAX], Z_[C * DMAX];
    static _Thread_local lane H_[DMAX * DMAX], g[DMAX];
    lane (*X)[D] = (lane (*)[D])X_, (*Y)[D] = (lane (*)[D])Y_, (*W)[D] = (lane (*)[D])W_;
    lane (*SUM)[D] = (lane (*)[D])SUM_, (*Z)[D] = (lane (*)[D])Z_, (*H)[D] = (lane (*)[D])H_;
    const size_t X_SIZE = A * D * sizeof(lane);
    for (long first = 0; first < n; first += LANES) {{
        lane x[S], y[S], sum[S], k[S], u[U], p[P + 1], a[{jacobian} + 1], b[{gradient} + 1];
        lane v[C], c_x[{sight_jacobian} + 1], c_p[{sight_gradient} + 1], w[C], m[C], e[C], q[C];
        long window[LANES];
        for (int l = 0; l < LANES; l++) window[l] = first + l < n ? first + l : n - 1;
        LOAD(x, x_0, S);
        LOAD(w, weight, C);
        LOAD(p, parameters, P);
        memset(X, 0, X_SIZE); memset(Y, 0, X_SIZE); memset(W, 0, X_SIZE); memset(SUM, 0, X_SIZE);
        memset(H, 0, D * D * sizeof(lane)); memset(g, 0, sizeof g); memset(q, 0, sizeof q);
        for (int i = 0; i < A; i++)
            if (slot[F + i] >= 0) for (int l = 0; l < LANES; l++) X[i][slot[F + i]][l] = 1;
        for (long t = 0; t <= intervals; t++) {{
            LOAD(m, measured + t * C * n, C);
            sight(x, p, v, c_x, c_p); look(c_x, c_p, slot, D, X, Z);
            for (int c = 0; c < C; c++)
                for (int l = 0; l < LANES; l++) {{
                    e[c][l] = w[c][l] * (v[c][l] - m[c][l]);
                    q[c][l] += e[c][l] * e[c][l];
                }}
            for (int i = 0; i < D; i++) {{
                lane J[C];
                #pragma omp simd
                for (int l = 0; l < LANES; l++) {{
{weighed}
                    g[i][l] += {along};
                }}
                for (int j = 0; j <= i; j++)
                    #pragma omp simd
                    for (int l = 0; l < LANES; l++) H[i][j][l] += {normal};
            }}
            if (t == intervals) break;
            LOAD(u, inputs + t * U * n, U);
            for (long step = 0; step < steps; step++) {{
                memcpy(sum, x, sizeof x);
                for (int i = 0; i < A; i++) if (on[i]) memcpy(SUM[i], X[i], sizeof X[i]);
                linearise(x, u, p, k, a, b); gather(sum, k, h / 6, S); along(x, k, h / 2, y, S);
                spread(a, b, slot, on, D, X, X, SUM, h / 6, Y, h / 2);
                linearise(y, u, p, k, a, b); gather(sum, k, h / 3, S); along(x, k, h / 2, y, S);
                spread(a, b, slot, on, D, Y, X, SUM, h / 3, W, h / 2);
                linearise(y, u, p, k, a, b); gather(sum, k, h / 3, S); along(x, k, h, y, S);
                spread(a, b, slot, on, D, W, X, SUM, h / 3, Y, h);
                linearise(y, u, p, k, a, b); gather(sum, k, h / 6, S);
                spread(a, b, slot, on, D, Y, X, SUM, h / 6, W, h);
                memcpy(x, sum, sizeof x);
                for (int i = 0; i < A; i++) if (on[i]) memcpy(X[i], SUM[i], sizeof X[i]);
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


PUSHED = """    if (on[{row}]) {{
        for (int d = 0; d < D; d++)
            #pragma omp simd
            for (int l = 0; l < LANES; l++) K[d][l] = {sum};
{own}
        for (int d = 0; d < D; d++)
            #pragma omp simd
            for (int l = 0; l < LANES; l++) {{
                sum[{row}][d][l] += g * K[d][l];
                Y[{row}][d][l] = base[{row}][d][l] + h * K[d][l];
            }}
    }}"""
OWN = """        if (on[{column}])
            for (int d = 0; d < D; d++)
                #pragma omp simd
                for (int l = 0; l < LANES; l++) K[d][l] += {term};"""


@contextmanager
def on_threads(count: int) -> Iterator[None]:
    """Let rollouts take so many threads; those begun in other threads take one."""
    before = _threads.set(count)
    try:
        yield
    finally:
        _threads.reset(before)


@dataclass(frozen=True)
class Windows:
    """Measured stretches of driving, all of T intervals of dt seconds.

    `initial` (S, W): full state at the start. `inputs` (T, U, W): what drives the car, held over each interval.
    `measured` (T + 1, C, W): the observed channels. `weight` (C, W): of their residuals; 0 leaves a channel out.
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
        changes["steering"] = Given()
    if measured_speed:
        changes["drive"] = Given()
    return dataclasses.replace(vehicle, **changes)


def true_inputs(car: Vehicle, shown: Mapping[str, Any], ops: Ops) -> dict[str, Any]:
    """Return what was true of the inputs (`INPUTS`) that sensors showed; what was not measured stays as it is.

    It is the inverse of `Vehicle.measured`, by fixed-point iteration, with a car that moves along nothing.
    """
    measured = {"delta": isinstance(car.steering, Given), "omega": isinstance(car.drive, Given)}
    true, others = dict(shown), dict.fromkeys(STATE, 0.0)
    for _ in range(UNDO):
        shows = car.measured({**others, **true}, ops)
        for name in INPUTS:
            if measured[name] and shows[name] is not true[name]:
                true[name] = true[name] + (shown[name] - shows[name])
    return true


class Equations:
    """What is rolled out: a vehicle, `names` of its parameters that vary, and the channels `observed`.

    `active` are the states that the observed ones depend on, no other is simulated; `effective` those of `names`.
    Parameters in `given` come with each call behind those of `names`, without sensitivities, so that one kernel serves
    cars of other values.
    """

    inputs = 2  # rows that drive the car: what its commands are

    def __init__(
        self, vehicle: Vehicle, names: Sequence[str], observed: Sequence[str], given: Sequence[str] = ()
    ) -> None:
        self.vehicle, self.names, self.observed, self.given = vehicle, list(names), list(observed), list(given)
        self.active, self.effective = _depended_on(self)

    def car(self, parameters: Sequence[Any]) -> Vehicle:
        """Return the vehicle with other values of `names` and `given`."""
        return replace_values(self.vehicle, dict(zip([*self.names, *self.given], parameters, strict=True)))

    def derivative(self, state: Any, inputs: Any, parameters: Sequence[Any], ops: Ops) -> Any:
        """Return d(state)/dt."""
        car = self.car(parameters)
        shown = dict(zip(INPUTS, ops.unstack(inputs), strict=True))
        return car.derivative(state, ops.stack(list(true_inputs(car, shown, ops).values())), ops)

    def observe(self, state: Sequence[Any], parameters: Sequence[Any], ops: Ops) -> list[Any]:
        """Return the observed channels of a state's rows, as sensors show them."""
        shown = self.car(parameters).measured(dict(zip(self.vehicle.states, state, strict=True)), ops)
        return [shown[name] for name in self.observed]


class Rollout(Equations):
    """The rollouts of a vehicle structure and their sensitivities, compiled where a compiler is at hand.

    Each call takes the threads of `on_threads`, else one.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        names: Sequence[str],
        observed: Sequence[str],
        step: float = 0.01,
        given: Sequence[str] = (),
    ) -> None:
        super().__init__(vehicle, names, observed, given)
        self.step = step
        self._library = _declared(build(source(self), QUICK))
        self.compiled = self._library is not None

    @property
    def size(self) -> int:
        """Number of unknowns of one window, D = P + A."""
        return len(self.names) + len(self.active)

    def nominal(self) -> Array:
        """Return the vehicle's own values of `names` and `given`, (P,)."""
        table = values(self.vehicle)
        return np.array([float(table[name]) for name in [*self.names, *self.given]])

    def simulate(self, parameters: Array, windows: Windows) -> Array:
        """Return the states (T + 1, S, W) of all windows, for parameters (P,) or (P, W); only active rows count."""
        parameters = _per_window(parameters, windows)
        steps, h = self.steps(windows.dt)
        intervals, states = len(windows.inputs), len(self.vehicle.states)
        if (library := self._library) is None:
            table = torch.as_tensor(np.array(parameters))
            initial, inputs = torch.as_tensor(windows.initial), torch.as_tensor(windows.inputs)
            return _roll_torch(self, table, initial, inputs, steps, h).numpy()

        def run(part: Windows, parameters: Array) -> Array:
            out = np.empty((intervals + 1, states, part.count))
            given = [part.initial, part.inputs, parameters, out]
            _call(library.simulate, given, part.count, intervals, steps, h)
            return out

        parts = _in_chunks(run, windows, parameters)
        return np.concatenate(parts, axis=2)

    def predict(self, parameters: Array, windows: Windows) -> Array:
        """Return the observed channels (T + 1, C, W) of all windows, as sensors show them."""
        states = torch.as_tensor(self.simulate(parameters, windows))
        table = torch.as_tensor(np.array(_per_window(parameters, windows)))
        shown = self.observe(states.unbind(1), table.unbind(0), TORCH)
        return torch.stack(torch.broadcast_tensors(*shown), dim=1).numpy()

    def squares(self, parameters: Array, windows: Windows) -> Array:
        """Return every window's squared weighted errors, summed per channel (W, C)."""
        parameters = _per_window(parameters, windows)
        steps, h = self.steps(windows.dt)
        if (library := self._library) is None:
            errors = windows.weight * (self.predict(parameters, windows) - windows.measured)
            return np.asarray((errors**2).sum(axis=0).T)

        def run(part: Windows, parameters: Array) -> Array:
            out = np.empty((part.count, len(self.observed)))
            given = [part.initial, part.inputs, parameters, part.measured, part.weight, out]
            _call(library.squares, given, part.count, len(windows.inputs), steps, h)
            return out

        return np.concatenate(_in_chunks(run, windows, parameters))

    def accumulate(
        self,
        parameters: Array,
        windows: Windows,
        columns: Sequence[int] | None = None,
        silent: Collection[str] = (),
    ) -> NormalEquations:
        """Return every window's normal equations at parameters (P,) or (P, W) and the windows' initial states.

        `columns` are the unknowns asked for, numbers in (names, active); all of them unless given. `silent` are states
        that what is observed does not depend on at these parameters, whose sensitivities need not be known.
        """
        parameters = _per_window(parameters, windows)
        steps, h = self.steps(windows.dt)
        asked = list(range(self.size)) if columns is None else list(columns)
        intervals, channels, size = len(windows.inputs), len(self.observed), len(asked)
        if (library := self._library) is None:
            return _accumulate_torch(self, parameters, windows, asked)
        slot = np.full(self.size, -1, dtype=np.int32)
        slot[asked] = np.arange(size)
        on = np.array([name not in silent for name in self.active], dtype=np.int32)

        def run(part: Windows, parameters: Array) -> tuple[Array, Array, Array]:
            out = np.empty((part.count, size, size)), np.empty((part.count, size)), np.empty((part.count, channels))
            given = [part.initial, part.inputs, parameters, part.measured, part.weight, *out]
            _call(library.accumulate, given, part.count, intervals, steps, h, slot, on)
            return out

        parts = _in_chunks(run, windows, parameters)
        return NormalEquations(*(np.concatenate(part) for part in zip(*parts, strict=True)))

    def steps(self, dt: float) -> tuple[int, float]:
        """Return how many Runge–Kutta steps one interval takes, and their length in s."""
        steps = max(1, round(np.ceil(dt / self.step - 1e-6)))
        return steps, dt / steps


def _per_window(parameters: Array, windows: Windows) -> Array:
    """Return parameters (P, W) from those, or from (P,) for all windows."""
    columns = parameters if parameters.ndim == 2 else parameters[:, None]
    return np.broadcast_to(columns, (len(parameters), windows.count))


def _in_chunks(run: Any, windows: Windows, parameters: Array) -> list[Any]:
    """Call `run` on chunks of windows, in order, the compiled kernel letting other threads work; on all of few."""
    threads = _threads.get()
    if threads == 1 or windows.count <= CHUNK:
        return [run(windows, parameters)]
    parts = [slice(first, first + CHUNK) for first in range(0, windows.count, CHUNK)]
    chunks = [(windows.take(part), parameters[:, part]) for part in parts]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(lambda chunk: run(*chunk), chunks))


def _declared(library: ctypes.CDLL | None) -> ctypes.CDLL | None:
    """Tell the C types of the kernel's functions, once: threads share the functions, and with them their types."""
    table: Any = ctypes.c_void_p
    whole: Any = ctypes.c_long
    shape = [whole, whole, whole, ctypes.c_double]
    if library is not None:
        library.simulate.argtypes = [table] * 4 + shape
        library.squares.argtypes = [table] * 6 + shape
        library.accumulate.argtypes = [table] * 8 + shape + [table, whole, table]
        for function in (library.simulate, library.squares, library.accumulate):
            function.restype = None
    return library


def _call(
    function: Any,
    arrays: Sequence[Array],
    count: int,
    intervals: int,
    steps: int,
    h: float,
    slot: NDArray[np.int32] | None = None,
    on: NDArray[np.int32] | None = None,
) -> None:
    contiguous = [np.ascontiguousarray(array, dtype=np.float64) for array in arrays]
    asked = [] if slot is None or on is None else [slot.ctypes.data, int(slot.max()) + 1, on.ctypes.data]
    function(*(array.ctypes.data for array in contiguous), count, intervals, steps, h, *asked)


def _symbols(rollout: Equations) -> tuple[Any, Any, Any, Any, Any]:
    """Return CasADi's x, u, p and the derivative and observation of them."""
    import casadi

    ops = CasadiOps()
    x, u = casadi.SX.sym("x", len(rollout.vehicle.states)), casadi.SX.sym("u", rollout.inputs)
    p = casadi.SX.sym("p", len(rollout.names) + len(rollout.given))
    parameters = ops.unstack(p) if p.numel() else []
    f = rollout.derivative(x, u, parameters, ops)
    return x, u, p, f, casadi.vertcat(*rollout.observe(ops.unstack(x), parameters, ops))


def _rates(vehicle: Vehicle) -> tuple[Any, Any, Any]:
    """Return CasADi's x, u and f(x, u) of a vehicle as it is."""
    import casadi

    x, u = casadi.SX.sym("x", len(vehicle.states)), casadi.SX.sym("u", 2)
    return x, u, vehicle.derivative(x, u, CasadiOps())


@symbolic
def fastest_rate(vehicle: Vehicle, states: Array) -> float:
    """Return the largest |eigenvalue| of ∂f/∂x over given states (S, N), in 1/s; RK4 is stable while h·|λ| < 2.7."""
    import casadi

    x, u, f = _rates(vehicle)
    jacobian = casadi.Function("jacobian", [x, u], [casadi.jacobian(f, x)]).map(states.shape[1])
    blocks = np.asarray(jacobian(states, states[[STATE.index("delta"), STATE.index("omega")]]))
    square = blocks.reshape(len(states), states.shape[1], len(states)).transpose(1, 0, 2)
    return float(np.abs(np.linalg.eigvals(square)).max())


@symbolic
def settle(vehicle: Vehicle, windows: Windows) -> None:
    """Set the effects' own initial states to where they rest in the measured motion: one Newton step on their rates.

    Exact for rates that are linear in those states, as lags are; states that never rest (clocks) stay as they are.
    """
    import casadi

    if len(vehicle.states) == len(STATE):
        return
    own = slice(len(STATE), len(vehicle.states))
    x, u, f = _rates(vehicle)
    count = windows.count
    rates = casadi.Function("rates", [x, u], [f[own], casadi.jacobian(f[own], x[own])]).map(count)
    f_own, f_xx = (np.asarray(part) for part in rates(windows.initial, windows.inputs[0, :2]))
    blocks = f_xx.reshape(len(f_own), count, len(f_own)).transpose(1, 0, 2)
    step = np.linalg.pinv(blocks, rcond=1e-9) @ f_own.T[:, :, None]
    windows.initial[own] -= step[:, :, 0].T


@symbolic
def _depended_on(equations: Equations) -> tuple[list[str], list[str]]:
    """Return the states that the observed channels depend on, in the vehicle's order, and those of `names`."""
    import casadi

    x, _, p, f, y = _symbols(equations)
    rows, columns = casadi.jacobian_sparsity(f, x).get_triplet()
    wanted = set(casadi.jacobian_sparsity(y, x).get_triplet()[1])
    while more := {j for i, j in zip(rows, columns, strict=True) if i in wanted} - wanted:
        wanted |= more
    seen = casadi.vertcat(f[sorted(wanted)], y)
    effective = set(casadi.jacobian_sparsity(seen, p[: len(equations.names)]).get_triplet()[1])
    return (
        [name for i, name in enumerate(equations.vehicle.states) if i in wanted],
        [name for i, name in enumerate(equations.names) if i in effective],
    )


@symbolic
def source(rollout: Equations) -> str:
    """Return the C source of the rollout and its sensitivities."""
    import casadi

    x, u, p, f, y = _symbols(rollout)
    states = rollout.vehicle.states
    rows, free = [states.index(name) for name in rollout.active], len(rollout.names)
    f = casadi.vertcat(*(f[i] if i in rows else 0.0 for i in range(len(states))))
    f, y = casadi.cse([f, y])  # before it is differentiated: what is shared has one derivative
    (f_x, f_p), (y_x, y_p) = (_slopes(of, x[rows], p[:free]) for of in (f[rows], y))
    plain = casadi.Function("derivative", [x, u, p], [f])
    linear = casadi.cse([f, casadi.vertcat(*f_x.nonzeros()), casadi.vertcat(*f_p.nonzeros())])
    linearised = casadi.Function("linearised", [x, u, p], linear)
    channels = range(len(rollout.observed))
    seen = [y, casadi.vertcat(*y_x.nonzeros()), casadi.vertcat(*y_p.nonzeros())]
    sight = casadi.Function("sight", [x, p], seen)
    return TEMPLATE.format(
        precision=precision("double"),
        lanes=LANES,
        states=len(states),
        active=len(rows),
        parameters=p.numel(),
        free=free,
        inputs=rollout.inputs,
        observed=len(rollout.observed),
        derivative=statements(plain, ("x", "u", "p"), ("k",)),
        linearised=statements(linearised, ("x", "u", "p"), ("k", "a", "b")),
        sight=statements(sight, ("x", "p"), ("y", "a", "b")),
        product="\n".join(_pushed(i, row, rollout.active) for i, row in enumerate(_terms(f_x))),
        direct=_direct("PUSH", f_p),
        seen="\n".join(f"            K[{i}][d][l] = {_sum(row.values())};" for i, row in enumerate(_terms(y_x))),
        seen_direct=_direct("SEE", y_p),
        weighed="\n".join(f"{20 * ' '}J[{c}][l] = w[{c}][l] * w[{c}][l] * Z[{c}][i][l];" for c in channels),
        along=_sum(f"w[{c}][l] * Z[{c}][i][l] * e[{c}][l]" for c in channels),
        normal=_sum(f"J[{c}][l] * Z[{c}][j][l]" for c in channels),
        jacobian=f_x.nnz(),
        gradient=f_p.nnz(),
        sight_jacobian=y_x.nnz(),
        sight_gradient=y_p.nnz(),
    )


def _slopes(of: Any, *by: Any) -> list[Any]:
    """Return the sparse Jacobian by each of some vectors; in reverse mode, for there are more of these than rows."""
    import casadi

    every = casadi.jtimes(of, casadi.vertcat(*by), casadi.SX.eye(of.numel()), True).T
    ends = np.cumsum([0, *(each.numel() for each in by)]).tolist()
    return [casadi.sparsify(part) for part in casadi.horzsplit(every, ends)]


def _terms(matrix: Any) -> list[dict[int, str]]:
    """Return C for the terms, by column, of each row of a sparse matrix, whose entries are in `a`, times X."""
    terms: list[dict[int, str]] = [{} for _ in range(matrix.size1())]
    for index, (i, j) in enumerate(zip(*matrix.sparsity().get_triplet(), strict=True)):
        terms[i][j] = f"a[{index}][l] * X[{j}][d][l]"
    return terms


def _sum(terms: Iterable[str]) -> str:
    return " + ".join(terms) or "0"


def _pushed(row: int, terms: Mapping[int, str], active: Sequence[str]) -> str:
    """Return C that spreads one row; effects' own states that are off have no share in it."""
    always = _sum(term for column, term in terms.items() if active[column] in STATE)
    own = (OWN.format(column=j, term=term) for j, term in terms.items() if active[j] not in STATE)
    return PUSHED.format(row=row, sum=always, own="\n".join(own))


def _direct(macro: str, matrix: Any) -> str:
    """Return C that adds a sparse matrix, whose entries are in `b`, to the columns of the parameters."""
    return "\n".join(
        f"    {macro}({i}, {j}, {index})"
        for index, (i, j) in enumerate(zip(*matrix.sparsity().get_triplet(), strict=True))
    )


def _roll_torch(
    rollout: Rollout, parameters: torch.Tensor, initial: torch.Tensor, inputs: torch.Tensor, steps: int, h: float
) -> torch.Tensor:
    """Return the states (T + 1, S, W), differentiable in the parameters."""
    rows = parameters.unbind(0)
    return roll_out(partial(rollout.derivative, parameters=rows, ops=TORCH), initial, inputs, steps, h)


def roll_out(
    derivative: Callable[[torch.Tensor, torch.Tensor], Any],
    initial: torch.Tensor,
    inputs: torch.Tensor,
    steps: int,
    h: float,
) -> torch.Tensor:
    """Return the states (T + 1, S, W) on torch by their derivative at inputs (T, U, W)."""

    def interval(state: torch.Tensor, held: torch.Tensor) -> torch.Tensor:
        for _ in range(steps):
            state = rk4(lambda now: derivative(now, held), state, h)
        return state

    return torch.stack(list(itertools.accumulate(inputs, interval, initial=initial)))


def residuals(rollout: Rollout, parameters: torch.Tensor, initial: torch.Tensor, windows: Windows) -> torch.Tensor:
    """Return w (x − y) (T + 1, C, W) on torch, differentiable in parameters (P, W) and initial states (S, W)."""
    states = _roll_torch(rollout, parameters, initial, torch.as_tensor(windows.inputs), *rollout.steps(windows.dt))
    shown = torch.broadcast_tensors(*rollout.observe(states.unbind(1), parameters.unbind(0), TORCH))
    return torch.as_tensor(windows.weight) * (torch.stack(shown, dim=1) - torch.as_tensor(windows.measured))


def _accumulate_torch(rollout: Rollout, parameters: Array, windows: Windows, asked: Sequence[int]) -> NormalEquations:
    """Form the normal equations by forward-mode differentiation, one unknown at a time."""
    active, free = [rollout.vehicle.states.index(name) for name in rollout.active], len(rollout.names)
    table, initial = torch.as_tensor(np.array(parameters)), torch.as_tensor(windows.initial)

    def residual(theta: torch.Tensor, initial: torch.Tensor) -> torch.Tensor:
        return residuals(rollout, torch.cat([theta, table[free:]]), initial, windows)

    theta = table[:free]
    unknowns = torch.eye(rollout.size, dtype=theta.dtype)[list(asked)]
    d_theta = unknowns[:, :free, None].expand(-1, -1, windows.count)
    d_initial = torch.zeros(len(unknowns), *initial.shape, dtype=theta.dtype)
    d_initial[:, active] = unknowns[:, free:, None]

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
