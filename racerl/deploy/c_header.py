"""A driver as a header in C99: constants and one function; it allocates nothing and needs no library.

That of a recurrent policy needs C's own mathematics (-lm).
"""

from collections.abc import Iterator

import numpy as np

from racerl.deploy.driver import Cell, Driver

PER_LINE = 8


def c_header(driver: Driver, title: str) -> str:
    """Return the header's text; `title` is a comment's first line."""
    sizes = [len(driver.sees), *(len(bias) for _, bias in driver.layers)]
    sizes[1] += driver.units  # behind the first layer's
    function = f"void racerl_drive({', '.join(_arguments(driver))})"
    remembers = [" * `memory` is what it remembers: all 0.0f at first, then left as it is."] if driver.cell else []
    lines = [
        f"/* {_comment(title)}",
        " *",
        f" * {function};",
        " *",
        *remembers,
        " * `drive_ref` holds the last drive reference and gets the new one. What is seen, in order:",
        *(f" *   {number:3d}  {each.name} [{each.unit}]" for number, each in enumerate(driver.sees)),
        " */",
        "#ifndef RACERL_POLICY_H",
        "#define RACERL_POLICY_H",
        "",
        *(["#include <math.h>", ""] if driver.cell else []),
        f"#define RACERL_SEEN {len(driver.sees)}",
        *([f"#define RACERL_MEMORY {driver.units}"] if driver.cell else []),
        "",
        *_array("racerl_maxima", driver.maxima),
    ]
    for number, (weight, bias) in enumerate(driver.layers):
        lines += [
            *_array(f"racerl_layer_{number}_weight", weight.ravel()),
            *_array(f"racerl_layer_{number}_bias", bias),
        ]
    if driver.cell:
        for name, values in vars(driver.cell).items():
            lines += _array(f"racerl_cell_{name}", values.ravel())
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
        *(_cell(driver.cell) if driver.cell else ()),
        f"static inline {function} {{",
        f"    float a[{max(sizes)}], b[{max(sizes)}];",
        "    for (int i = 0; i < RACERL_SEEN; i++)",
        f"        a[i] = racerl_clip(seen[i] / racerl_maxima[i], {_f(-driver.limit)}, {_f(driver.limit)});",
    ]
    here, there = "a", "b"
    for number, ((_, bias), inputs) in enumerate(zip(driver.layers, sizes, strict=False)):
        slope = 1.0 if number == len(driver.layers) - 1 else driver.slope
        lines.append(
            f"    racerl_layer({_names(f'layer_{number}')}, {here}, {inputs}, {there}, {len(bias)}, {_f(slope)});"
        )
        here, there = there, here
        if driver.cell and not number:
            lines.append(f"    racerl_remember({here}, memory);")
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


def _arguments(driver: Driver) -> list[str]:
    memory = ["float memory[RACERL_MEMORY]"] if driver.cell else []
    return ["const float seen[RACERL_SEEN]", *memory, "float *drive_ref", "float *delta_ref"]


def _cell(cell: Cell) -> list[str]:
    """Return a function that brings the memory up to date, and puts it behind the values that it is told."""
    units = cell.units
    return [
        "static inline float racerl_sigmoid(float value) { return 1.0f / (1.0f + expf(-value)); }",
        "",
        "static inline void racerl_remember(float *value, float *memory) {",
        f"    float told[{3 * units}], known[{3 * units}];",
        f"    racerl_layer({_names('cell')}, value, {units}, told, {3 * units}, 1.0f);",
        f"    racerl_layer({_names('cell_memory')}, memory, {units}, known, {3 * units}, 1.0f);",
        f"    for (int i = 0; i < {units}; i++) {{",
        "        float reset = racerl_sigmoid(told[i] + known[i]);",
        f"        float update = racerl_sigmoid(told[i + {units}] + known[i + {units}]);",
        f"        float fresh = tanhf(told[i + {2 * units}] + reset * known[i + {2 * units}]);",
        "        memory[i] = fresh + update * (memory[i] - fresh);",
        f"        value[i + {units}] = memory[i];",
        "    }",
        "}",
        "",
    ]


def _names(part: str) -> str:
    return f"racerl_{part}_weight, racerl_{part}_bias"


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
