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

from racerl.vehicle.compiler import build

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
static inline long downhill(const float (*cells)[8], long count, long from, long way, long reach, float x, float y,
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

/* s, n and the centreline's direction of the foot of (x, y), followed from `last` */
static inline void foot_of(const float (*cells)[8], long count, float spacing, long reach, float x, float y, float last,
                           float *s, float *n, float *direction) {{
    float ahead, behind;
    long from = lroundf(last / spacing) % count;
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
        *n = (2 * left - kappa * squared) / (1 + sqrtf(stretch * stretch + kappa * along * kappa * along));
    else {{
        ds = 0;
        *n = left > 0 ? sqrtf(squared) : left < 0 ? -sqrtf(squared) : 0;
    }}
    float place = at * spacing + ds, length = count * spacing;
    place = place < 0 ? place + length : place;
    *s = place >= length ? place - length : place;
    *direction = wrap_angle(cell[2] + kappa * ds);
}}

void project(const float (*cells)[8], long count, float spacing, long reach, const float *x, const float *y,
             const float *last, float *s, float *n, float *direction, long cars) {{
    for (long car = 0; car < cars; car++)
        foot_of(cells, count, spacing, reach, x[car], y[car], last[car], &s[car], &n[car], &direction[car]);
}}

/* rows of `place`: s, n, heading against the centreline, offset from the middle, margin to the nearer boundary; and
   the way from `last` */
void locate(const float (*cells)[8], long count, float spacing, long reach, const float *x, const float *y,
            const float *yaw, const float *last, float *place, long cars) {{
    const float length = count * spacing;
    for (long car = 0; car < cars; car++) {{
        float s, n, direction;
        foot_of(cells, count, spacing, reach, x[car], y[car], last[car], &s, &n, &direction);
        float position = s / spacing, cell = floorf(position), share = position - cell;
        long at = cell >= 0 && cell < count ? (long)cell : 0, next = at + 1 >= count ? 0 : at + 1;  /* NaN too */
        float offset = n - (cells[at][6] + share * (cells[next][6] - cells[at][6]));
        place[car] = s;
        place[cars + car] = n;
        place[2 * cars + car] = wrap_angle(yaw[car] - direction);
        place[3 * cars + car] = offset;
        place[4 * cars + car] = cells[at][7] + share * (cells[next][7] - cells[at][7]) - fabsf(offset);
        float way = s - last[car] + length / 2;
        place[5 * cars + car] = way - length * floorf(way / length) - length / 2;
    }}
}}

/* x, y and the centreline's direction at (s, n), exact to the arc within a cell */
static __attribute__((noinline)) void position_of(const float (*cells)[8], long count, float spacing, float s, float n,
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

void position(const float (*cells)[8], long count, float spacing, const float *s, const float *n, float *x, float *y,
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
            cells.shape[0],
            spacing,
            reach,
            *(t.data_ptr() for t in (x, y, s_last, s, n, yaw)),
            x.numel(),
        )
        return s, n, yaw

    def locate(
        self, cells: Tensor, x: Tensor, y: Tensor, yaw: Tensor, s_last: Tensor, spacing: float, reach: int
    ) -> Tensor:
        """Return s, n, heading, offset, margin and the way from `s_last`, (6, N)."""
        given = [t.to(cells.dtype).contiguous() for t in (x, y, yaw, s_last)]
        place = torch.empty(6, x.numel(), dtype=cells.dtype)
        pointers = (t.data_ptr() for t in (*given, place))
        self.compiled.locate(cells.data_ptr(), cells.shape[0], spacing, reach, *pointers, x.numel())
        return place

    def position(self, cells: Tensor, s: Tensor, n: Tensor, spacing: float) -> tuple[Tensor, Tensor, Tensor]:
        """Return x, y and the centreline's yaw at (s, n), each (N,)."""
        s, n = s.to(cells.dtype).contiguous(), n.to(cells.dtype).contiguous()
        x, y, yaw = torch.empty_like(s), torch.empty_like(s), torch.empty_like(s)
        pointers = (t.data_ptr() for t in (s, n, x, y, yaw))
        self.compiled.position(cells.data_ptr(), cells.shape[0], spacing, *pointers, s.numel())
        return x, y, yaw

    def lookup(self, tables: Sequence[Tensor], s: Tensor, spacing: float) -> list[Tensor]:
        """Return the tables (M,) interpolated linearly and periodically at s of any shape."""
        s = s.to(tables[0].dtype).contiguous()
        out = torch.empty((len(tables), *s.shape), dtype=s.dtype)
        rows = (ctypes.c_void_p * len(tables))(*(table.data_ptr() for table in tables))
        self.compiled.lookup(rows, len(tables), tables[0].shape[0], spacing, s.data_ptr(), out.data_ptr(), s.numel())
        return list(out.unbind())


@functools.cache
def load_kernel(ridge: float, smallest_stretch: float) -> TrackKernel | None:
    """Build the functions, or take them from the cache; None without a compiler."""
    library = build(TEMPLATE.format(ridge=ridge, smallest=smallest_stretch))
    if library is None:
        return None
    pointer, whole, number = ctypes.c_void_p, ctypes.c_long, ctypes.c_float
    library.project.argtypes = [pointer, whole, number, whole, *[pointer] * 6, whole]
    library.locate.argtypes = [pointer, whole, number, whole, *[pointer] * 5, whole]
    library.lookup.argtypes = [pointer, whole, whole, number, pointer, pointer, whole]
    library.position.argtypes = [pointer, whole, number, *[pointer] * 5, whole]
    for function in (library.project, library.locate, library.position, library.lookup):
        function.restype = None
    return TrackKernel(library)
