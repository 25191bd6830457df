"""From CasADi functions to compiled C: one statement per instruction inside a loop over lanes, which the system's
compiler vectorises.

The library is kept in the user's cache under a hash of source, compiler and processor, so that it is built once, also
where many processes ask for it at once.
"""

import ctypes
import functools
import hashlib
import logging
import math
import os
import platform
import shutil
import signal
import subprocess
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.polynomial import Chebyshev, Polynomial
from numpy.typing import NDArray

from racerl.documents import alone, user_cache

Array = NDArray[np.float64]

log = logging.getLogger(__name__)

# fast-math lets the compiler take the vector versions of sin, atan, …; NaN still spreads through sums.
# cos is written as a shifted sin: sin and cos of one angle would be fused to a complex exponential, which has none.
FLAGS = ("-march=native", "-ffast-math", "-fopenmp-simd", "-fPIC")
THOROUGH, QUICK = ("-O3",), ("-O1", "-ftree-vectorize", "-fno-tree-slp-vectorize")

FUNCTIONS = ("sin", "atan", "tanh", "exp", "sqrt", "fabs")

# odd series in single precision, cheaper than the vector library's: sin x = r·S(r²) with r = x − 2πk in ± π, and
# atan t = t·A(t²) for t ≤ 1, atan x = π/2 − atan(1/x) above
SINGLE = """
LOCAL inline float series_sin(float x) {{
    float r = x - rintf(x * {inverse_turn}f) * {turn}f, z = r * r;
    return r * ({sine});
}}

LOCAL inline float series_atan(float x) {{
    float a = fabsf(x), t = a > 1 ? 1 / a : a, z = t * t, y = t * ({arctangent});
    y = a > 1 ? {half_pi}f - y : y;
    return x < 0 ? -y : y;
}}

LOCAL inline float series_exp(float x) {{
    x = x > 80 ? 80 : x < -80 ? -80 : x;
    float k = rintf(x * {inverse_log_2}f), z = x - k * {log_2}f + {half_log_2}f;
    union {{ int bits; float number; }} power;
    power.bits = ((int)k + 127) << 23;
    return power.number * ({exponential});
}}

LOCAL inline float series_tanh(float x) {{
    return 1 - 2 / (series_exp(2 * x) + 1);
}}
"""


def _horner(function: Callable[[Array], Array], end: float, degree: int) -> str:
    """Return C for the polynomial in z through a function at the Chebyshev points of [0, end]."""
    found = Chebyshev.interpolate(function, degree, domain=[0.0, end]).convert(kind=Polynomial, domain=[-1, 1])
    text = ""
    for coefficient in found.coef[::-1]:
        text = f"({text} * z + {coefficient:.9e}f)" if text else f"{coefficient:.9e}f"
    return text


def precision(name: str) -> str:
    """Return the C definitions of `real` and its functions for "float" or "double"; `LOCAL` must be defined."""
    if name == "double":
        return "typedef double real;\n" + "".join(f"#define {f.upper()} {f}\n" for f in FUNCTIONS)
    series = SINGLE.format(
        turn=repr(2 * math.pi),
        inverse_turn=repr(0.5 / math.pi),
        half_pi=repr(math.pi / 2),
        log_2=repr(math.log(2)),
        half_log_2=repr(math.log(2) / 2),
        inverse_log_2=repr(1 / math.log(2)),
        exponential=_horner(lambda z: np.exp(z - math.log(2) / 2), math.log(2), 5),
        sine=_horner(lambda z: np.sinc(np.sqrt(z) / math.pi), math.pi**2, 6),
        arctangent=_horner(lambda z: np.arctan(np.sqrt(z)) / np.sqrt(z), 1.0, 7),
    )
    named = {**{f: f"{f}f" for f in FUNCTIONS}, **{f: f"series_{f}" for f in ("sin", "atan", "exp", "tanh")}}
    return "typedef float real;\n" + series + "".join(f"#define {f.upper()} {c}\n" for f, c in named.items())


def statements(function: Any, inputs: Sequence[str], outputs: Sequence[str]) -> str:
    """Return one C statement per instruction of a CasADi function.

    Inputs and outputs are arrays of `real` with one row per number and one column per lane `l`.
    """
    import casadi

    forms = {
        casadi.OP_ASSIGN: "{0}",
        casadi.OP_ADD: "{0} + {1}",
        casadi.OP_SUB: "{0} - {1}",
        casadi.OP_MUL: "{0} * {1}",
        casadi.OP_DIV: "{0} / {1}",
        casadi.OP_NEG: "-{0}",
        casadi.OP_EXP: "EXP({0})",
        casadi.OP_SQ: "{0} * {0}",
        casadi.OP_TWICE: "2 * {0}",
        casadi.OP_INV: "1 / {0}",
        casadi.OP_SIN: "SIN({0})",
        casadi.OP_COS: f"SIN({{0}} + (real){math.pi / 2!r})",
        casadi.OP_ATAN: "ATAN({0})",
        casadi.OP_TANH: "TANH({0})",
        casadi.OP_FABS: "FABS({0})",
        casadi.OP_SQRT: "SQRT({0})",
        casadi.OP_LT: "(real)({0} < {1})",
        casadi.OP_LE: "(real)({0} <= {1})",
        casadi.OP_EQ: "(real)({0} == {1})",
        casadi.OP_NE: "(real)({0} != {1})",
        casadi.OP_NOT: "(real)({0} == 0)",
        casadi.OP_SIGN: "(real)(({0} > 0) - ({0} < 0))",
        casadi.OP_FMIN: "({0} < {1} ? {0} : {1})",
        casadi.OP_FMAX: "({0} > {1} ? {0} : {1})",
        casadi.OP_IF_ELSE_ZERO: "({0} != 0 ? {1} : 0)",
    }
    lines = [f"        real {', '.join(f'w{i}' for i in range(function.sz_w()))};"]
    for k in range(function.n_instructions()):
        operation, to, of = (function.instruction_id(k), function.instruction_output(k), function.instruction_input(k))
        if operation == casadi.OP_CONST:
            line = f"w{to[0]} = (real){function.instruction_constant(k)!r}"
        elif operation == casadi.OP_INPUT:
            line = f"w{to[0]} = {inputs[of[0]]}[{of[1]}][l]"
        elif operation == casadi.OP_OUTPUT:
            line = f"{outputs[to[0]]}[{to[1]}][l] = w{of[0]}"
        else:
            line = f"w{to[0]} = " + forms[operation].format(*(f"w{i}" for i in of))
        lines.append(f"        {line};")
    return "\n".join(lines)


def cache_folder() -> Path:
    """Return where compiled kernels are kept."""
    return user_cache("kernels")


@functools.cache
def _find_compiler() -> str | None:
    """Return the C compiler's path; say once when there is none."""
    for name in (os.environ.get("CC"), "cc", "gcc", "clang"):
        if name and (path := shutil.which(name)):
            return path
    log.warning("no C compiler found; computing on torch, several times slower (install gcc to change that)")
    return None


def build(code: str, effort: Sequence[str] = THOROUGH) -> ctypes.CDLL | None:
    """Compile the source, or take it from the cache; None (and a line in the log) when that is not possible.

    `QUICK` takes less than half of the time; loops have to be written out for it, and vectorised by pragma. Raises
    KeyboardInterrupt where the user interrupts the compiler, in whichever thread that is.
    """
    compiler = _find_compiler()
    if compiler is None:
        return None
    try:
        version = subprocess.run([compiler, "--version"], capture_output=True, check=True, timeout=30).stdout  # noqa: S603
        about = [code, *effort, *FLAGS, version.decode(errors="replace"), _processor()]
        identity = hashlib.sha256("\0".join(about).encode())
        library = cache_folder() / f"{identity.hexdigest()[:32]}.so"
        if not library.is_file():
            _compile([compiler, *effort, *FLAGS], code, library)
        return ctypes.CDLL(str(library))
    except (OSError, subprocess.SubprocessError) as error:
        if isinstance(error, subprocess.CalledProcessError) and error.returncode == -signal.SIGINT:
            raise KeyboardInterrupt from error
        log.warning("the kernel could not be compiled (%s); computing on torch, several times slower", error)
        return None


def _compile(compiler: Sequence[str], code: str, library: Path) -> None:
    """Build beside the target and rename; processes that want the same library wait for the first of them."""
    library.parent.mkdir(parents=True, exist_ok=True)
    with alone(library.with_suffix(".lock")), tempfile.TemporaryDirectory(dir=library.parent) as folder:
        if library.is_file():
            return
        path, unit, built = (Path(folder) / f"kernel.{suffix}" for suffix in ("c", "o", "so"))
        path.write_text(code)
        # linked without -ffast-math, which would make the whole process flush subnormal numbers to zero
        for command in (
            [*compiler, "-c", str(path), "-o", str(unit)],
            [compiler[0], "-shared", str(unit), "-o", str(built), "-lm"],
        ):
            subprocess.run(command, capture_output=True, check=True)  # noqa: S603
        built.replace(library)


def _processor() -> str:
    """Return what -march=native depends on."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        return next((line for line in lines if line.startswith(("flags", "Features"))), platform.machine())
    except OSError:
        return platform.machine()
