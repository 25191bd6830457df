"""The car's motion as a compiled kernel: the one derivative, traced by CasADi, written as C, built by the system's
compiler at first use.

`Vehicle.derivative` and its vector-Jacobian product become loops over 16 cars (see `codegen`). Parameters that differ
between cars are inputs, all others constants. The same source is CUDA, with a car per thread. Gradients run backwards
through the Runge–Kutta steps: with λ = ∂L/∂x', k̄_4 = hλ/6, k̄_3 = hλ/3 + h f_xᵀk̄_4, k̄_2 = hλ/3 + h/2 f_xᵀk̄_3,
k̄_1 = hλ/6 + h/2 f_xᵀk̄_2, λ ← λ + Σ f_xᵀk̄_i. The library is checked against torch on random states before it is used.
Without a compiler the step runs on torch.
"""

import ctypes
import logging
from collections.abc import Callable, Sequence
from typing import Any, cast

import torch
from torch import Tensor

from racerl.errors import VehicleError
from racerl.vehicle.bodies import BodyMotion
from racerl.vehicle.codegen import precision, statements
from racerl.vehicle.compiler import build
from racerl.vehicle.integrate import advance, settled
from racerl.vehicle.ops import TORCH, CasadiOps
from racerl.vehicle.parameter import replace_values, values
from racerl.vehicle.vehicle import STATE, Vehicle

log = logging.getLogger(__name__)

LANES = 16
TABLES = {"advance": 4, "pull": 7}  # kernels and how many tables they take
CUDA_BLOCK = 128  # threads, a car each
TOLERANCE = 1e-4  # of the check at start-up, relative to the size of each state

TEMPLATE = """
#ifdef __CUDACC__
#define restrict __restrict__
#define LANES 1
#define LOCAL static __device__
#define SHARED extern "C" __global__
#define EACH_GROUP for (int first = blockIdx.x * blockDim.x + threadIdx.x; first < n; first += gridDim.x * blockDim.x)
#else
#include <math.h>
#define LANES {lanes}
#define LOCAL static
#define SHARED
#define EACH_GROUP for (int first = 0; first < n; first += LANES)
#endif
#define STEPS {steps}
{precision}
static const real H = {dt!r};

LOCAL inline void derivative(const real (*restrict x)[LANES], const real (*restrict u)[LANES],
                              const real (*restrict p)[LANES], real (*restrict d)[LANES]) {{
    #pragma omp simd
    for (int l = 0; l < LANES; l++) {{
{derivative}
    }}
}}

LOCAL inline void settle(const real (*restrict x)[LANES], const real (*restrict u)[LANES],
                          const real (*restrict p)[LANES], real (*restrict d)[LANES]) {{
    #pragma omp simd
    for (int l = 0; l < LANES; l++) {{
{settle}
    }}
}}

/* (dx, du, dp) = kᵀ ∂f/∂(x, u, p) */
LOCAL inline void pull_derivative(const real (*restrict x)[LANES], const real (*restrict u)[LANES],
                                   const real (*restrict p)[LANES], const real (*restrict k)[LANES],
                                   real (*restrict dx)[LANES], real (*restrict du)[LANES],
                                   real (*restrict dp)[LANES]) {{
    #pragma omp simd
    for (int l = 0; l < LANES; l++) {{
{pull_derivative}
    }}
}}

LOCAL inline void pull_settle(const real (*restrict x)[LANES], const real (*restrict u)[LANES],
                               const real (*restrict p)[LANES], const real (*restrict k)[LANES],
                               real (*restrict dx)[LANES], real (*restrict du)[LANES], real (*restrict dp)[LANES]) {{
    #pragma omp simd
    for (int l = 0; l < LANES; l++) {{
{pull_settle}
    }}
}}

LOCAL void along(const real (*restrict x)[LANES], const real (*restrict k)[LANES], real h,
                  real (*restrict y)[LANES]) {{
    for (int i = 0; i < {states}; i++)
        for (int l = 0; l < LANES; l++) y[i][l] = x[i][l] + h * k[i][l];
}}

LOCAL void add(real (*restrict to)[LANES], const real (*restrict what)[LANES], int rows) {{
    for (int i = 0; i < rows; i++)
        for (int l = 0; l < LANES; l++) to[i][l] += what[i][l];
}}

/* the first rows of four tables for LANES cars from `first` on; the last car fills the lanes beyond it */
LOCAL void load(const real *table, real (*restrict to)[LANES], int rows, int first, int n) {{
    for (int i = 0; i < rows; i++)
        for (int l = 0; l < LANES; l++) to[i][l] = table[(long)i * n + (first + l < n ? first + l : n - 1)];
}}

LOCAL void store(real *table, const real (*restrict from)[LANES], int rows, int first, int n) {{
    for (int i = 0; i < rows; i++)
        for (int l = 0; l < LANES && first + l < n; l++) table[(long)i * n + first + l] = from[i][l];
}}

typedef real States[{states}][LANES];

LOCAL void stages(const States x, const real (*restrict u)[LANES], const real (*restrict p)[LANES],
                   States k1, States k2, States k3, States y2, States y3, States y4) {{
    derivative(x, u, p, k1);
    along(x, k1, H / 2, y2);
    derivative(y2, u, p, k2);
    along(x, k2, H / 2, y3);
    derivative(y3, u, p, k3);
    along(x, k3, H, y4);
}}

LOCAL void step(States x, const real (*restrict u)[LANES], const real (*restrict p)[LANES]) {{
    States k1, k2, k3, k4, y2, y3, y4;
    stages(x, u, p, k1, k2, k3, y2, y3, y4);
    derivative(y4, u, p, k4);
    for (int i = 0; i < {states}; i++)
        for (int l = 0; l < LANES; l++) x[i][l] += H / 6 * (k1[i][l] + 2 * (k2[i][l] + k3[i][l]) + k4[i][l]);
}}

SHARED void advance(const real *state, const real *command, const real *parameters, real *out, int n) {{
    EACH_GROUP {{
        States x, y;
        real u[2][LANES], p[{parameters} + 1][LANES];
        load(state, x, {states}, first, n);
        load(command, u, 2, first, n);
        load(parameters, p, {parameters}, first, n);
        for (int k = 0; k < STEPS; k++) step(x, u, p);
        settle(x, u, p, y);
        store(out, y, {states}, first, n);
    }}
}}

/* cotangents of the state after `steps` steps → of state, command and parameters before them */
SHARED void pull(const real *state, const real *command, const real *parameters, const real *cotangent, real *to_state,
          real *to_command, real *to_parameters, int n) {{
    EACH_GROUP {{
        States trace[STEPS + 1], g, d, k1, k2, k3, y2, y3, y4;
        real u[2][LANES], p[{parameters} + 1][LANES];
        real du[2][LANES], gu[2][LANES], dp[{parameters} + 1][LANES], gp[{parameters} + 1][LANES];
        load(state, trace[0], {states}, first, n);
        load(command, u, 2, first, n);
        load(parameters, p, {parameters}, first, n);
        for (int k = 0; k < STEPS; k++) {{
            along(trace[k], trace[k], 0, trace[k + 1]);
            step(trace[k + 1], u, p);
        }}
        load(cotangent, d, {states}, first, n);
        pull_settle(trace[STEPS], u, p, d, g, gu, gp);
        for (int k = STEPS - 1; k >= 0; k--) {{
            States bar, total;
            stages(trace[k], u, p, k1, k2, k3, y2, y3, y4);
            const real (*at[4])[LANES] = {{trace[k], y2, y3, y4}};
            const real share[4] = {{H / 6, H / 3, H / 3, H / 6}}, carried[4] = {{H / 2, H / 2, H, 0}};
            along(g, g, 0, total);
            for (int stage = 3; stage >= 0; stage--) {{
                for (int i = 0; i < {states}; i++)
                    for (int l = 0; l < LANES; l++)
                        bar[i][l] = share[stage] * g[i][l] + (stage < 3 ? carried[stage] * d[i][l] : 0);
                pull_derivative(at[stage], u, p, bar, d, du, dp);
                add(total, d, {states});
                add(gu, du, 2);
                add(gp, dp, {parameters});
            }}
            along(total, total, 0, g);
        }}
        store(to_state, g, {states}, first, n);
        store(to_command, gu, 2, first, n);
        store(to_parameters, gp, {parameters}, first, n);
    }}
}}
"""


class TorchMotion:
    """The step on torch: any device and precision, differentiable."""

    name = "torch"

    def __init__(self, vehicle: Vehicle, names: Sequence[str], dt: float, steps: int) -> None:
        self.vehicle, self.names, self.dt, self.steps = vehicle, list(names), dt, steps

    def __call__(self, state: Tensor, command: Tensor, parameters: Tensor) -> Tensor:
        """Return the state (S, N) after `steps` steps, with the named parameters (P, N) per car."""
        vehicle = replace_values(self.vehicle, dict(zip(self.names, parameters, strict=True)))
        return advance(vehicle, state, command, self.dt, self.steps, TORCH)


Launch = Callable[[str, Sequence[Tensor], int], None]  # a kernel by name, its tables, the number of cars


class CompiledMotion:
    """The step as a compiled kernel in single precision, differentiable."""

    name = "compiled"

    def __init__(self, launch: Launch) -> None:
        self._launch = launch

    def __call__(self, state: Tensor, command: Tensor, parameters: Tensor) -> Tensor:
        """Return the state (S, N) after the steps, with per-car parameters (P, N)."""
        if not torch.is_grad_enabled():
            return self.advance([t.contiguous() for t in (state, command, parameters)])
        return cast(Tensor, _Advance.apply(state, command, parameters, self))

    def advance(self, inputs: Sequence[Tensor]) -> Tensor:
        """Return the state after the steps for contiguous state, command and parameters."""
        out = torch.empty_like(inputs[0])
        self._launch("advance", (*inputs, out), out.shape[1])
        return out

    def pull(self, inputs: Sequence[Tensor], cotangent: Tensor) -> tuple[Tensor, ...]:
        """Return the cotangents of state, command and parameters for one of the state after the steps."""
        found = tuple(map(torch.empty_like, inputs))
        self._launch("pull", (*inputs, cotangent.contiguous(), *found), cotangent.shape[1])
        return found


class _Advance(torch.autograd.Function):
    """The compiled step with its gradient."""

    @staticmethod
    def forward(ctx: Any, state: Tensor, command: Tensor, parameters: Tensor, motion: CompiledMotion) -> Tensor:
        inputs = [t.contiguous() for t in (state, command, parameters)]
        ctx.motion = motion
        ctx.save_for_backward(*inputs)
        return motion.advance(inputs)

    @staticmethod
    def backward(ctx: Any, *cotangents: Tensor) -> tuple[Tensor | None, ...]:
        idle = (cotangents[0] == 0.0).all(dim=0)  # cars that nothing hangs on: one that failed has NaN for a slope
        return (*(each.masked_fill(idle, 0.0) for each in ctx.motion.pull(ctx.saved_tensors, cotangents[0])), None)


Motion = TorchMotion | CompiledMotion | BodyMotion


def choose_motion(
    vehicle: Vehicle, names: Sequence[str], dt: float, steps: int, device: torch.device, dtype: torch.dtype
) -> Motion:
    """Return the fastest motion that this machine can run, for a car whose named parameters differ between cars."""
    if vehicle.body and device.type != "cpu":
        raise VehicleError(f"vehicle.body = {vehicle.body}: is driven on the CPU; give device=cpu")
    if vehicle.body:
        return BodyMotion(vehicle, names, dt * steps)
    reference = TorchMotion(vehicle, names, dt, steps)
    if dtype != torch.float32:
        return reference
    code = source(vehicle, names, dt, steps)
    launch = _for_cuda(code, device) if device.type == "cuda" else _for_cpu(code)
    if launch is None:
        return reference
    compiled = CompiledMotion(launch)
    if _deviation(compiled, reference, device) > TOLERANCE:
        log.warning("the compiled simulator disagrees with torch; simulating on torch, more slowly")
        return reference
    return compiled


def _for_cpu(code: str) -> Launch | None:
    library = build(code)
    if library is None:
        return None
    for name, tables in TABLES.items():
        getattr(library, name).argtypes = [ctypes.c_void_p] * tables + [ctypes.c_int]
        getattr(library, name).restype = None

    def launch(name: str, tables: Sequence[Tensor], count: int) -> None:
        getattr(library, name)(*(table.data_ptr() for table in tables), count)

    return launch


def _for_cuda(code: str, device: torch.device) -> Launch | None:
    try:
        with torch.cuda.device(device):
            kernels = {name: torch.cuda._compile_kernel(code, name) for name in TABLES}
    except (RuntimeError, AttributeError, OSError) as error:
        log.warning("the kernel could not be compiled for CUDA (%s); simulating on torch, far more slowly", error)
        return None

    def launch(name: str, tables: Sequence[Tensor], count: int) -> None:
        grid = -(-count // CUDA_BLOCK), 1, 1
        kernels[name](grid=grid, block=(CUDA_BLOCK, 1, 1), args=[*tables, count])

    return launch


def source(vehicle: Vehicle, names: Sequence[str], dt: float, steps: int) -> str:
    """Return the source of `steps` Runge–Kutta steps of dt seconds, C and CUDA alike."""
    import casadi

    ops = CasadiOps()
    state, command = casadi.SX.sym("x", len(vehicle.states)), casadi.SX.sym("u", 2)
    parameters = casadi.SX.sym("p", len(names))
    car = replace_values(vehicle, dict(zip(names, ops.unstack(parameters) if names else [], strict=True)))
    inputs = [state, command, parameters]
    outcomes = {"derivative": car.derivative(state, command, ops), "settle": settled(car, state, command, ops)}
    bodies = {}
    for name, outcome in outcomes.items():
        function = casadi.Function(name, inputs, [outcome])
        bodies[name] = statements(function, ("x", "u", "p"), ("d",))
        cotangent = casadi.SX.sym("k", len(vehicle.states))
        pulled = [casadi.densify(casadi.jtimes(outcome, of, cotangent, True)) for of in inputs]
        function = casadi.Function(name, [*inputs, cotangent], pulled, {"cse": True})
        bodies[f"pull_{name}"] = statements(function, ("x", "u", "p", "k"), ("dx", "du", "dp"))
    return TEMPLATE.format(
        precision=precision("float"),
        lanes=LANES,
        dt=dt,
        steps=steps,
        states=len(vehicle.states),
        parameters=len(names),
        **bodies,
    )


def _deviation(compiled: CompiledMotion, reference: TorchMotion, device: torch.device) -> float:
    """Return the largest difference of one step and its gradients on random states, relative to 1 + |value|."""
    generator = torch.Generator().manual_seed(0)
    state = torch.rand(len(reference.vehicle.states), 64, generator=generator) - 0.5
    state[STATE.index("v_x")] += 2.0
    state[STATE.index("omega")] += 2.0
    command = torch.rand(2, 64, generator=generator) - 0.5
    command[1] += 2.0
    nominal = values(reference.vehicle)
    table = torch.tensor([float(nominal[name]) for name in reference.names])[:, None].expand(-1, 64)
    inputs = [tensor.to(device) for tensor in (state, command, table)]
    return max(map(_apart, _with_gradients(compiled, *inputs), _with_gradients(reference, *inputs)))


def _with_gradients(motion: Motion, *inputs: Tensor) -> tuple[Tensor, ...]:
    """Return the state after the step and the gradients of its sum by the inputs."""
    leaves = [tensor.clone().requires_grad_() for tensor in inputs]
    with torch.enable_grad():
        out = motion(*leaves)
        return out.detach(), *torch.autograd.grad(out.sum(), leaves, allow_unused=True, materialize_grads=True)


def _apart(got: Tensor, expected: Tensor) -> float:
    return float(((got - expected).abs() / (1.0 + expected.abs())).max().nan_to_num(torch.inf)) if got.numel() else 0.0
