"""Projection and look-ups of `frenet` as C for the CPU in single precision, a car at a time.

What is computed, and why, stands in `racerl.track.frenet`; a test holds the two together.
"""

import ctypes
import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from racerl.vehicle.codegen import build

TEMPLATE = """
#include <math.h>
#define RIDGE {ridge!r}f
#define SMALLEST_STRETCH {smallest!r}f
#define PI 3.14159265358979f
#define LANES 16

static inline float wrap_angle(float angle) {{
    return angle - 2 * PI * floorf((angle + PI) / (2 * PI));
}}

/* cells from `from` to the bottom of the valley on one side, and the squared distance there */
static inline long downhill(const float (*cells)[6], long count, long from, long way, long reach, float x, float y,
                            float *squared) {{
    long best = 0, at = from;
    float least = INFINITY, lowest = INFINITY;
    for (long k = 0; k <= reach; k++) {{
        float dx = x - cells[at][0], dy = y - cells[at][1], now = dx * dx + dy * dy;
        least = now < least ? now : least;
        if (!(now <= RIDGE * least)) break;
        if (now < lowest) {{ lowest = now; best = k; }}
        at += way;
        at = at < 0 ? count - 1 : at >= count ? 0 : at;
    }}
    *squared = lowest;
    return best;
}}

void project(const float (*cells)[6], long count, float spacing, long reach, const float *px, const float *py,
             const float *last, float *s, float *n, float *direction, long cars) {{
    for (long car = 0; car < cars; car++) {{
        float x = px[car], y = py[car], ahead, behind;
        long from = lroundf(last[car] / spacing) % count;
        from = from < 0 ? from + count : from;  /* NaN lands in the table too */
        long forth = downhill(cells, count, from, 1, reach, x, y, &ahead);
        long back = downhill(cells, count, from, -1, reach, x, y, &behind);
        long at = (from + (ahead <= behind ? forth : -back) + count) % count;
        const float *cell = cells[at];
        float dx = x - cell[0], dy = y - cell[1], kappa = cell[5];
        float along = dx * cell[3] + dy * cell[4], left = dy * cell[3] - dx * cell[4];
        float stretch = 1 - kappa * left;
        float slope = along / (fabsf(stretch) < SMALLEST_STRETCH ? SMALLEST_STRETCH : stretch);
        float ds = slope * (1 - kappa * slope * kappa * slope / 3);
        ds = ds > spacing ? spacing : ds < -spacing ? -spacing : ds;
        float squared = along * along + left * left;
        if (stretch > 0)
            n[car] = (2 * left - kappa * squared)
                   / (1 + sqrtf(stretch * stretch + kappa * along * kappa * along));
        else {{
            ds = 0;
            n[car] = left > 0 ? sqrtf(squared) : left < 0 ? -sqrtf(squared) : 0;
        }}
        float place = at * spacing + ds, length = count * spacing;
        place = place < 0 ? place + length : place;
        s[car] = place >= length ? place - length : place;
        direction[car] = wrap_angle(cell[2] + kappa * ds);
    }}
}}

/* x, y and the centreline's direction at (s, n), exact to the arc within a cell */
static __attribute__((noinline)) void position_of(const float (*cells)[6], long count, float spacing, float s, float n,
                                                  float *x, float *y, float *direction) {{
    const float length = count * spacing;
    s -= length * floorf(s / length);
    long nearest = lroundf(s / spacing), at = nearest % count;
    const float *cell = cells[at < 0 ? 0 : at];
    float ds = s - nearest * spacing, bend = cell[5] * ds;
    float chord = ds * (1 - bend * bend / 24), half = cell[2] + bend / 2, turn = cell[2] + bend;
    *x = cell[0] + chord * cosf(half) - n * sinf(turn);
    *y = cell[1] + chord * sinf(half) + n * cosf(turn);
    *direction = wrap_angle(turn);
}}

void position(const float (*cells)[6], long count, float spacing, const float *s, const float *n, float *x, float *y,
              float *direction, long cars) {{
    for (long car = 0; car < cars; car++)
        position_of(cells, count, spacing, s[car], n[car], &x[car], &y[car], &direction[car]);
}}

/* tables at s, one row of `out` each; in whole groups, so that a number does not depend on how many are asked for */
void lookup(const float *const *tables, long rows, long count, float spacing, const float *s, float *out,
            long numbers) {{
    const float length = count * spacing;
    for (long first = 0; first < numbers; first += LANES) {{
        float given[LANES], share[LANES], found[LANES];
        int at[LANES], next[LANES];
        for (int l = 0; l < LANES; l++) given[l] = s[first + l < numbers ? first + l : numbers - 1];
        #pragma omp simd
        for (int l = 0; l < LANES; l++) {{
            float position = (given[l] - length * floorf(given[l] / length)) / spacing;
            float cell = floorf(position);
            int index = (int)cell;
            share[l] = position - cell;
            at[l] = index >= (int)count ? index - (int)count : index < 0 ? 0 : index;
            next[l] = at[l] + 1 >= (int)count ? 0 : at[l] + 1;
        }}
        for (long row = 0; row < rows; row++) {{
            const float *table = tables[row];
            #pragma omp simd
            for (int l = 0; l < LANES; l++) found[l] = table[at[l]] + share[l] * (table[next[l]] - table[at[l]]);
            for (int l = 0; l < LANES && first + l < numbers; l++) out[row * numbers + first + l] = found[l];
        }}
    }}
}}
"""


@dataclass(frozen=True)
class TrackKernel:
    """The compiled functions."""

    compiled: Any

    def project(
        self, cells: Tensor, x: Tensor, y: Tensor, s_last: Tensor, spacing: float, reach: int
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Return s, n and the centreline's yaw, each (N,)."""
        x, y, s_last = x.contiguous(), y.contiguous(), s_last.to(x.dtype).contiguous()
        s, n, yaw = torch.empty_like(x), torch.empty_like(x), torch.empty_like(x)
        self.compiled.project(
            cells.data_ptr(),
            len(cells),
            spacing,
            reach,
            *(t.data_ptr() for t in (x, y, s_last, s, n, yaw)),
            x.numel(),
        )
        return s, n, yaw

    def position(self, cells: Tensor, s: Tensor, n: Tensor, spacing: float) -> tuple[Tensor, Tensor, Tensor]:
        """Return x, y and the centreline's yaw at (s, n), each (N,)."""
        s, n = s.to(cells.dtype).contiguous(), n.to(cells.dtype).contiguous()
        x, y, yaw = torch.empty_like(s), torch.empty_like(s), torch.empty_like(s)
        pointers = (t.data_ptr() for t in (s, n, x, y, yaw))
        self.compiled.position(cells.data_ptr(), len(cells), spacing, *pointers, s.numel())
        return x, y, yaw

    def lookup(self, tables: Sequence[Tensor], s: Tensor, spacing: float) -> list[Tensor]:
        """Return the tables (M,) interpolated linearly and periodically at s of any shape."""
        s = s.to(tables[0].dtype).contiguous()
        out = torch.empty((len(tables), *s.shape), dtype=s.dtype)
        rows = (ctypes.c_void_p * len(tables))(*(table.data_ptr() for table in tables))
        self.compiled.lookup(rows, len(tables), len(tables[0]), spacing, s.data_ptr(), out.data_ptr(), s.numel())
        return list(out.unbind())


@functools.cache
def load_kernel(ridge: float, smallest_stretch: float) -> TrackKernel | None:
    """Build the functions, or take them from the cache; None without a compiler."""
    library = build(TEMPLATE.format(ridge=ridge, smallest=smallest_stretch))
    if library is None:
        return None
    pointer, whole, number = ctypes.c_void_p, ctypes.c_long, ctypes.c_float
    library.project.argtypes = [pointer, whole, number, whole, *[pointer] * 6, whole]
    library.lookup.argtypes = [pointer, whole, whole, number, pointer, pointer, whole]
    library.position.argtypes = [pointer, whole, number, *[pointer] * 5, whole]
    library.project.restype = library.position.restype = library.lookup.restype = None
    return TrackKernel(library)
