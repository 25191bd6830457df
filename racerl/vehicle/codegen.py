"""From CasADi functions to compiled C: one statement per instruction inside a loop over lanes, which the system's
compiler (see `compiler`) vectorises.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.polynomial import Chebyshev, Polynomial
from numpy.typing import NDArray

Array = NDArray[np.float64]

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
