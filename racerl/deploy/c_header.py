"""A driver as a header in C99: constants and one function; it allocates nothing and needs no library."""

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from racerl.deploy.driver import Driver

PER_LINE = 8


def c_header(driver: Driver, title: str) -> str:
    """Return the header's text; `title` is a comment's first line."""
    sizes = [len(driver.sees), *(len(bias) for _, bias in driver.layers)]
    lines = [
        f"/* {_comment(title)}",
        " *",
        " * void racerl_drive(const float seen[RACERL_SEEN], float *drive_ref, float *delta_ref);",
        " *",
        " * `drive_ref` holds the last drive reference and gets the new one. What is seen, in order:",
        *(f" *   {number:3d}  {each.name} [{each.unit}]" for number, each in enumerate(driver.sees)),
        " */",
        "#ifndef RACERL_POLICY_H",
        "#define RACERL_POLICY_H",
        "",
        f"#define RACERL_SEEN {len(driver.sees)}",
        "",
        *_array("racerl_maxima", driver.maxima),
    ]
    for number, (weight, bias) in enumerate(driver.layers):
        lines += [*_array(f"racerl_weight_{number}", weight.ravel()), *_array(f"racerl_bias_{number}", bias)]
    lines += [
        "",
        "static inline float racerl_clip(float value, float low, float high) {",
        "    return value < low ? low : value > high ? high : value;",
        "}",
        "",
        "static inline void racerl_layer(const float *weight, const float *bias, const float *in, int inputs,",
        "                                float *out, int units, float slope) {",
        "    for (int i = 0; i < units; i++) {",
        "        float sum = bias[i];",
        "        for (int j = 0; j < inputs; j++) sum += weight[i * inputs + j] * in[j];",
        "        out[i] = sum > 0.0f ? sum : slope * sum;",
        "    }",
        "}",
        "",
        "static inline void racerl_drive(const float seen[RACERL_SEEN], float *drive_ref, float *delta_ref) {",
        f"    float a[{max(sizes)}], b[{max(sizes)}];",
        "    for (int i = 0; i < RACERL_SEEN; i++)",
        f"        a[i] = racerl_clip(seen[i] / racerl_maxima[i], {_f(-driver.limit)}, {_f(driver.limit)});",
    ]
    here, there = "a", "b"
    for number, (inputs, units) in enumerate(pairwise(sizes)):
        slope = 1.0 if number == len(driver.layers) - 1 else driver.slope
        named = f"racerl_weight_{number}, racerl_bias_{number}"
        lines.append(f"    racerl_layer({named}, {here}, {inputs}, {there}, {units}, {_f(slope)});")
        here, there = there, here
    base = "*drive_ref" if driver.middle is None else _f(driver.middle)
    drive = f"{base} + {_f(driver.gain)} * racerl_clip({here}[1], -1.0f, 1.0f)"
    lines += [
        f"    *delta_ref = {_f(driver.steering_max)} * racerl_clip({here}[0], -1.0f, 1.0f);",
        f"    *drive_ref = racerl_clip({drive}, {_f(driver.drive_min)}, {_f(driver.drive_max)});",
        "}",
        "",
        "#endif",
    ]
    return "\n".join(lines) + "\n"


def _array(name: str, values: "np.ndarray[tuple[int, ...], np.dtype[np.float32]]") -> Iterator[str]:
    yield f"static const float {name}[{len(values)}] = {{"
    for start in range(0, len(values), PER_LINE):
        yield "    " + ", ".join(_f(value) for value in values[start : start + PER_LINE]) + ","
    yield "};"


def _f(value: float) -> str:
    """Return a float literal that reads back as the same number."""
    text = f"{np.float32(value):.9g}"
    return text + ("f" if any(c in text for c in ".e") else ".0f")


def _comment(text: str) -> str:
    """Return a text that cannot end a comment."""
    return " ".join(text.replace("*/", "* /").split())
