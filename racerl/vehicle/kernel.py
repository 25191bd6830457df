"""The car's motion as a compiled kernel: the one derivative, traced by CasADi, written as C, built by the system's
compiler at first use.

`Vehicle.derivative` becomes one loop over 16 cars (see `codegen`). Parameters that differ between cars are inputs, all
others constants. The library is checked against torch on random states before it is used. Without a compiler the same
step runs on torch.
"""

import ctypes
import logging
from collections.abc import Sequence

import torch
from torch import Tensor

from racerl.vehicle.codegen import PRECISIONS, build, statements
from racerl.vehicle.integrate import advance
from racerl.vehicle.ops import TORCH, CasadiOps
from racerl.vehicle.parameter import replace_values, values
from racerl.vehicle.vehicle import STATE, Vehicle

log = logging.getLogger(__name__)

LANES = 16
TOLERANCE = 1e-4  # of the check at start-up, relative to the size of each state

TEMPLATE = """
#include <math.h>
{precision}
#define LANES {lanes}

static inline void derivative(const real (*restrict x)[LANES], const real (*restrict u)[LANES],
                              const real (*restrict p)[LANES], real (*restrict d)[LANES]) {{
    #pragma omp simd
    for (int l = 0; l < LANES; l++) {{
{derivative}
    }}
}}

static inline void settle(const real (*restrict x)[LANES], const real (*restrict u)[LANES],
                          const real (*restrict p)[LANES], real (*restrict d)[LANES]) {{
    #pragma omp simd
    for (int l = 0; l < LANES; l++) {{
{settle}
    }}
}}

static void along(const real (*restrict x)[LANES], const real (*restrict k)[LANES], real h,
                  real (*restrict y)[LANES]) {{
    for (int i = 0; i < {states}; i++)
        for (int l = 0; l < LANES; l++) y[i][l] = x[i][l] + h * k[i][l];
}}

void advance(const real *state, const real *command, const real *parameters, real *out, long n, long steps,
             real h) {{
    for (long first = 0; first < n; first += LANES) {{
        real x[{states}][LANES], y[{states}][LANES], u[2][LANES], p[{parameters} + 1][LANES];
        real k1[{states}][LANES], k2[{states}][LANES], k3[{states}][LANES], k4[{states}][LANES];
        for (int l = 0; l < LANES; l++) {{
            long car = first + l < n ? first + l : n - 1;
            for (int i = 0; i < {states}; i++) x[i][l] = state[i * n + car];
            for (int i = 0; i < 2; i++) u[i][l] = command[i * n + car];
            for (int i = 0; i < {parameters}; i++) p[i][l] = parameters[i * n + car];
        }}
        for (long step = 0; step < steps; step++) {{
            derivative(x, u, p, k1);
            along(x, k1, h / 2, y);
            derivative(y, u, p, k2);
            along(x, k2, h / 2, y);
            derivative(y, u, p, k3);
            along(x, k3, h, y);
            derivative(y, u, p, k4);
            for (int i = 0; i < {states}; i++)
                for (int l = 0; l < LANES; l++)
                    x[i][l] += h / 6 * (k1[i][l] + 2 * (k2[i][l] + k3[i][l]) + k4[i][l]);
        }}
        settle(x, u, p, y);
        for (int l = 0; l < LANES && first + l < n; l++)
            for (int i = 0; i < {states}; i++) out[i * n + first + l] = y[i][l];
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


class CompiledMotion:
    """The step as a compiled kernel: single precision on the CPU."""

    name = "compiled"

    def __init__(self, library: ctypes.CDLL, dt: float, steps: int) -> None:
        self._advance = library.advance
        pointer = ctypes.c_void_p
        self._advance.argtypes = [pointer] * 4 + [ctypes.c_long, ctypes.c_long, ctypes.c_float]
        self._advance.restype = None
        self.dt, self.steps = dt, steps

    def __call__(self, state: Tensor, command: Tensor, parameters: Tensor) -> Tensor:
        """Return the state (S, N) after `steps` steps, with per-car parameters (P, N)."""
        state, command, parameters = state.contiguous(), command.contiguous(), parameters.contiguous()
        out = torch.empty_like(state)
        self._advance(
            state.data_ptr(),
            command.data_ptr(),
            parameters.data_ptr(),
            out.data_ptr(),
            state.shape[1],
            self.steps,
            self.dt,
        )
        return out


def choose_motion(
    vehicle: Vehicle, names: Sequence[str], dt: float, steps: int, device: torch.device, dtype: torch.dtype
) -> TorchMotion | CompiledMotion:
    """Return the fastest motion that this machine can run, for a car whose named parameters differ between cars."""
    reference = TorchMotion(vehicle, names, dt, steps)
    if device.type != "cpu" or dtype != torch.float32:
        return reference
    library = build(source(vehicle, names))
    if library is None:
        return reference
    compiled = CompiledMotion(library, dt, steps)
    if _deviation(compiled, reference, len(names)) > TOLERANCE:
        log.warning("the compiled simulator disagrees with torch; simulating on torch, more slowly")
        return reference
    return compiled


def source(vehicle: Vehicle, names: Sequence[str]) -> str:
    """Return the C source of the step."""
    import casadi

    ops = CasadiOps()
    state, command = casadi.SX.sym("x", len(vehicle.states)), casadi.SX.sym("u", 2)
    parameters = casadi.SX.sym("p", len(names))
    car = replace_values(vehicle, dict(zip(names, ops.unstack(parameters) if names else [], strict=True)))
    inputs = [state, command, parameters]
    rows = list(ops.unstack(state))
    delta, omega = STATE.index("delta"), STATE.index("omega")
    rows[delta] = car.steering.position(rows[delta], command[0])
    rows[omega] = car.drive.position(rows[omega], command[1])
    functions = {
        "derivative": casadi.Function("derivative", inputs, [car.derivative(state, command, ops)]),
        "settle": casadi.Function("settle", inputs, [ops.stack(rows)]),
    }
    bodies = {name: statements(function, ("x", "u", "p"), ("d",)) for name, function in functions.items()}
    return TEMPLATE.format(
        precision=PRECISIONS["float"], lanes=LANES, states=len(vehicle.states), parameters=len(names), **bodies
    )


def _deviation(compiled: CompiledMotion, reference: TorchMotion, parameters: int) -> float:
    """Return the largest difference of one step on random states, relative to 1 + |value|."""
    generator = torch.Generator().manual_seed(0)
    state = torch.rand(len(reference.vehicle.states), 64, generator=generator) - 0.5
    state[STATE.index("v_x")] += 2.0
    state[STATE.index("omega")] += 2.0
    command = torch.rand(2, 64, generator=generator) - 0.5
    command[1] += 2.0
    nominal = values(reference.vehicle)
    table = torch.tensor([float(nominal[name]) for name in reference.names])[:, None].expand(parameters, 64)
    expected, got = reference(state, command, table), compiled(state, command, table)
    return float(((got - expected).abs() / (1.0 + expected.abs())).max().nan_to_num(torch.inf))
