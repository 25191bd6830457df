"""The car's motion as a compiled kernel: the one derivative, traced by CasADi, written as C, built by the system's
compiler at first use.

CasADi turns `Vehicle.derivative` into a list of elementary instructions; each becomes one C statement inside a loop
over 16 cars, which the compiler vectorises. Parameters that differ between cars are inputs, all others constants. The
library is kept in the user's cache under a hash of source, compiler and processor, and checked against torch on random
states before it is used. Without a compiler the same step runs on torch.
"""

import ctypes
import functools
import hashlib
import logging
import math
import os
import platform
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from racerl.vehicle.integrate import advance
from racerl.vehicle.ops import TORCH, CasadiOps
from racerl.vehicle.parameter import replace_values, values
from racerl.vehicle.vehicle import STATE, Vehicle

log = logging.getLogger(__name__)

LANES = 16
# fast-math lets the compiler take the vector versions of sin, atan, …; NaN still spreads through sums.
# cos is written as a shifted sin: sin and cos of one angle would be fused to a complex exponential, which has none.
FLAGS = ("-O3", "-march=native", "-ffast-math", "-fopenmp-simd", "-fPIC")
TOLERANCE = 1e-4  # of the check at start-up, relative to the size of each state
BUILD_TIME_LIMIT = 120  # s

TEMPLATE = """
#include <math.h>
#define LANES {lanes}

static inline void derivative(const float (*restrict x)[LANES], const float (*restrict u)[LANES],
                              const float (*restrict p)[LANES], float (*restrict d)[LANES]) {{
    #pragma omp simd
    for (int l = 0; l < LANES; l++) {{
{derivative}
    }}
}}

static inline void settle(const float (*restrict x)[LANES], const float (*restrict u)[LANES],
                          const float (*restrict p)[LANES], float (*restrict d)[LANES]) {{
    #pragma omp simd
    for (int l = 0; l < LANES; l++) {{
{settle}
    }}
}}

static void along(const float (*restrict x)[LANES], const float (*restrict k)[LANES], float h,
                  float (*restrict y)[LANES]) {{
    for (int i = 0; i < {states}; i++)
        for (int l = 0; l < LANES; l++) y[i][l] = x[i][l] + h * k[i][l];
}}

void advance(const float *state, const float *command, const float *parameters, float *out, long n, long steps,
             float h) {{
    for (long first = 0; first < n; first += LANES) {{
        float x[{states}][LANES], y[{states}][LANES], u[2][LANES], p[{parameters} + 1][LANES];
        float k1[{states}][LANES], k2[{states}][LANES], k3[{states}][LANES], k4[{states}][LANES];
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
    library = _build(source(vehicle, names))
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
    bodies = {name: "\n".join(_statements(function)) for name, function in functions.items()}
    return TEMPLATE.format(lanes=LANES, states=len(vehicle.states), parameters=len(names), **bodies)


def _statements(function: Any) -> list[str]:
    """Return one C statement per instruction of a CasADi function."""
    import casadi

    forms = {
        casadi.OP_ASSIGN: "{0}",
        casadi.OP_ADD: "{0} + {1}",
        casadi.OP_SUB: "{0} - {1}",
        casadi.OP_MUL: "{0} * {1}",
        casadi.OP_DIV: "{0} / {1}",
        casadi.OP_NEG: "-{0}",
        casadi.OP_EXP: "expf({0})",
        casadi.OP_SQ: "{0} * {0}",
        casadi.OP_TWICE: "2 * {0}",
        casadi.OP_INV: "1 / {0}",
        casadi.OP_SIN: "sinf({0})",
        casadi.OP_COS: f"sinf({{0}} + {math.pi / 2!r}f)",
        casadi.OP_ATAN: "atanf({0})",
        casadi.OP_TANH: "tanhf({0})",
        casadi.OP_FABS: "fabsf({0})",
        casadi.OP_SQRT: "sqrtf({0})",
        casadi.OP_LT: "(float)({0} < {1})",
        casadi.OP_LE: "(float)({0} <= {1})",
        casadi.OP_EQ: "(float)({0} == {1})",
        casadi.OP_NE: "(float)({0} != {1})",
        casadi.OP_NOT: "(float)({0} == 0)",
        casadi.OP_SIGN: "(float)(({0} > 0) - ({0} < 0))",
        casadi.OP_FMIN: "({0} < {1} ? {0} : {1})",
        casadi.OP_FMAX: "({0} > {1} ? {0} : {1})",
        casadi.OP_IF_ELSE_ZERO: "({0} != 0 ? {1} : 0)",
    }
    arrays = ("x", "u", "p")
    lines = [f"        float {', '.join(f'w{i}' for i in range(function.sz_w()))};"]
    for k in range(function.n_instructions()):
        operation, to, of = (function.instruction_id(k), function.instruction_output(k), function.instruction_input(k))
        if operation == casadi.OP_CONST:
            line = f"w{to[0]} = {function.instruction_constant(k)!r}f"
        elif operation == casadi.OP_INPUT:
            line = f"w{to[0]} = {arrays[of[0]]}[{of[1]}][l]"
        elif operation == casadi.OP_OUTPUT:
            line = f"d[{to[1]}][l] = w{of[0]}"
        else:
            line = f"w{to[0]} = " + forms[operation].format(*(f"w{i}" for i in of))
        lines.append(f"        {line};")
    return lines


def cache_folder() -> Path:
    """Return where compiled kernels are kept."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "racerl" / "kernels"


@functools.cache
def _find_compiler() -> str | None:
    """Return the C compiler's path; say once when there is none."""
    for name in (os.environ.get("CC"), "cc", "gcc", "clang"):
        if name and (path := shutil.which(name)):
            return path
    log.warning("no C compiler found; simulating on torch, several times slower (install gcc to change that)")
    return None


def _build(code: str) -> ctypes.CDLL | None:
    """Compile the source, or take it from the cache; None (and a line in the log) when that is not possible."""
    compiler = _find_compiler()
    if compiler is None:
        return None
    try:
        version = subprocess.run([compiler, "--version"], capture_output=True, check=True, timeout=30).stdout  # noqa: S603
        identity = hashlib.sha256("\0".join([code, *FLAGS, version.decode(errors="replace"), _processor()]).encode())
        library = cache_folder() / f"{identity.hexdigest()[:32]}.so"
        if not library.is_file():
            _compile(compiler, code, library)
        return ctypes.CDLL(str(library))
    except (OSError, subprocess.SubprocessError) as error:
        log.warning("the simulator could not be compiled (%s); simulating on torch, several times slower", error)
        return None


def _compile(compiler: str, code: str, library: Path) -> None:
    """Build beside the target and rename, so that many processes may do it at once."""
    library.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=library.parent) as folder:
        path, unit, built = (Path(folder) / f"kernel.{suffix}" for suffix in ("c", "o", "so"))
        path.write_text(code)
        # linked without -ffast-math, which would make the whole process flush subnormal numbers to zero
        for command in (
            [compiler, *FLAGS, "-c", str(path), "-o", str(unit)],
            [compiler, "-shared", str(unit), "-o", str(built), "-lm"],
        ):
            subprocess.run(command, capture_output=True, check=True, timeout=BUILD_TIME_LIMIT)  # noqa: S603
        built.replace(library)


def _processor() -> str:
    """Return what -march=native depends on."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        return next((line for line in lines if line.startswith(("flags", "Features"))), platform.machine())
    except OSError:
        return platform.machine()


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
