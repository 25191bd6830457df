"""Projection and look-ups of `frenet` as C for the CPU in single precision, a car at a time.

What is computed, and why, stands in `racerl.track.frenet`; a test holds the two together.
"""

import ctypes
import functools
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

void lookup(const float *table, long count, float spacing, const float *s, float *out, long numbers) {{
    const float length = count * spacing;
    #pragma omp simd
    for (long i = 0; i < numbers; i++) {{
        float position = (s[i] - length * floorf(s[i] / length)) / spacing;
        float cell = floorf(position), share = position - cell;
        int at = (int)cell;
        at = at >= (int)count ? at - (int)count : at < 0 ? 0 : at;
        int next = at + 1 >= (int)count ? 0 : at + 1;
        out[i] = table[at] + share * (table[next] - table[at]);
    }}
}}
"""


@dataclass(frozen=True)
class TrackKernel:
    """The compiled functions."""

    library: Any

    def project(
        self, cells: Tensor, x: Tensor, y: Tensor, s_last: Tensor, spacing: float, reach: int
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Return s, n and the centreline's yaw, each (N,)."""
        x, y, s_last = x.contiguous(), y.contiguous(), s_last.to(x.dtype).contiguous()
        s, n, yaw = torch.empty_like(x), torch.empty_like(x), torch.empty_like(x)
        self.library.project(
            cells.data_ptr(),
            len(cells),
            spacing,
            reach,
            *(t.data_ptr() for t in (x, y, s_last, s, n, yaw)),
            x.numel(),
        )
        return s, n, yaw

    def lookup(self, table: Tensor, s: Tensor, spacing: float) -> Tensor:
        """Return the table (M,) interpolated linearly and periodically at s of any shape."""
        s = s.to(table.dtype).contiguous()
        out = torch.empty_like(s)
        self.library.lookup(table.data_ptr(), len(table), spacing, s.data_ptr(), out.data_ptr(), s.numel())
        return out


@functools.cache
def load_kernel(ridge: float, smallest_stretch: float) -> TrackKernel | None:
    """Build the functions, or take them from the cache; None without a compiler."""
    library = build(TEMPLATE.format(ridge=ridge, smallest=smallest_stretch))
    if library is None:
        return None
    pointer, whole, number = ctypes.c_void_p, ctypes.c_long, ctypes.c_float
    library.project.argtypes = [pointer, whole, number, whole, *[pointer] * 6, whole]
    library.lookup.argtypes = [pointer, whole, number, pointer, pointer, whole]
    library.project.restype = library.lookup.restype = None
    return TrackKernel(library)
