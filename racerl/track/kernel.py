"""Projection and look-ups of `frenet` as C for the CPU in single precision, a car at a time.

What is computed, and why, stands in `racerl.track.frenet`; a test holds the two together.
"""

import ctypes
import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, cast

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

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

/* where the foot of (x, y), followed from `last`, is: its cell, the car along and left of its point, m from there;
   s, n and the centreline's direction */
struct foot {{ long at; float along, left, ds, s, n, direction; }};
static inline struct foot foot_of(const float (*cells)[8], long count, float spacing, long reach, float x, float y,
                                  float last) {{
    struct foot found;
    float ahead, behind;
    long from = lroundf(last / spacing) % count;
    from = from < 0 ? from + count : from;  /* NaN lands in the table too */
    long forth = downhill(cells, count, from, 1, reach, x, y, &ahead);
    long back = downhill(cells, count, from, -1, reach, x, y, &behind);
    found.at = (from + (ahead <= behind ? forth : -back) + count) % count;
    const float *cell = cells[found.at];
    float dx = x - cell[0], dy = y - cell[1], kappa = cell[5];
    float along = dx * cell[3] + dy * cell[4], left = dy * cell[3] - dx * cell[4];
    float stretch = 1 - kappa * left;
    float slope = along / (fabsf(stretch) < SMALLEST_STRETCH ? SMALLEST_STRETCH : stretch);
    float ds = slope * (1 - kappa * slope * kappa * slope / 3);
    ds = ds > spacing ? spacing : ds < -spacing ? -spacing : ds;
    float squared = along * along + left * left;
    if (stretch > 0)
        found.n = (2 * left - kappa * squared) / (1 + sqrtf(stretch * stretch + kappa * along * kappa * along));
    else {{
        ds = 0;
        found.n = left > 0 ? sqrtf(squared) : left < 0 ? -sqrtf(squared) : 0;
    }}
    float place = found.at * spacing + ds, length = count * spacing;
    place = place < 0 ? place + length : place;
    found.s = place >= length ? place - length : place;
    found.direction = wrap_angle(cell[2] + kappa * ds);
    found.along = along;
    found.left = left;
    found.ds = ds;
    return found;
}}

void project(const float (*cells)[8], long count, float spacing, long reach, const float *x, const float *y,
             const float *last, float *s, float *n, float *direction, long cars) {{
    for (long car = 0; car < cars; car++) {{
        struct foot foot = foot_of(cells, count, spacing, reach, x[car], y[car], last[car]);
        s[car] = foot.s;
        n[car] = foot.n;
        direction[car] = foot.direction;
    }}
}}

/* the entries of a table on both sides of an s in [0, length), and how far it is from one to the other */
struct between {{ long at, next; float share; }};
static inline struct between around(float s, long count, float spacing) {{
    float position = s / spacing, cell = floorf(position);
    long at = cell >= 0 && cell < count ? (long)cell : 0;  /* NaN too */
    return (struct between){{at, at + 1 >= count ? 0 : at + 1, position - cell}};
}}

/* rows of `place`: s, n, heading against the centreline, offset from the middle, margin to the nearer boundary; and
   the way from `last` */
void locate(const float (*cells)[8], long count, float spacing, long reach, const float *x, const float *y,
            const float *yaw, const float *last, float *place, long cars) {{
    const float length = count * spacing;
    for (long car = 0; car < cars; car++) {{
        struct foot foot = foot_of(cells, count, spacing, reach, x[car], y[car], last[car]);
        struct between b = around(foot.s, count, spacing);
        const float *here = cells[b.at], *ahead = cells[b.next];
        float offset = foot.n - (here[6] + b.share * (ahead[6] - here[6]));
        place[car] = foot.s;
        place[cars + car] = foot.n;
        place[2 * cars + car] = wrap_angle(yaw[car] - foot.direction);
        place[3 * cars + car] = offset;
        place[4 * cars + car] = here[7] + b.share * (ahead[7] - here[7]) - fabsf(offset);
        float way = foot.s - last[car] + length / 2;
        place[5 * cars + car] = way - length * floorf(way / length) - length / 2;
    }}
}}

/* cotangents of x, y, yaw and `last` for those of what `locate` has found: what is computed there, differentiated */
void pull_locate(const float (*cells)[8], long count, float spacing, long reach, const float *x, const float *y,
                 const float *yaw, const float *last, const float *of, float *pulled, long cars) {{
    for (long car = 0; car < cars; car++) {{
        struct foot foot = foot_of(cells, count, spacing, reach, x[car], y[car], last[car]);
        const float *own = cells[foot.at];
        float kappa = own[5], along = foot.along, left = foot.left, stretch = 1 - kappa * left;
        float ds_along = 0, ds_left = 0, n_along, n_left;
        if (stretch > 0) {{
            int tight = stretch < SMALLEST_STRETCH;
            float room = tight ? SMALLEST_STRETCH : stretch, slope = along / room;
            float root = sqrtf(stretch * stretch + kappa * along * kappa * along);
            ds_along = fabsf(foot.ds) < spacing ? (1 - kappa * slope * kappa * slope) / room : 0;
            ds_left = tight ? 0 : ds_along * kappa * slope;
            n_along = -kappa * along * (2 + foot.n * kappa / root) / (1 + root);
            n_left = stretch * (2 + foot.n * kappa / root) / (1 + root);
        }} else {{  /* there n is the distance to the cell's point */
            n_along = foot.n != 0 ? along / foot.n : 0;
            n_left = foot.n != 0 ? left / foot.n : 0;
        }}
        struct between b = around(foot.s, count, spacing);
        const float *here = cells[b.at], *ahead = cells[b.next];
        float middle = ahead[6] - here[6], half = ahead[7] - here[7], offset = foot.n - (here[6] + b.share * middle);
        float of_offset = of[3 * cars + car] - (offset > 0 ? 1 : offset < 0 ? -1 : 0) * of[4 * cars + car];
        float of_n = of[cars + car] + of_offset;
        float of_s = of[car] + of[5 * cars + car] + (half * of[4 * cars + car] - middle * of_offset) / spacing
                     - kappa * of[2 * cars + car];
        float of_along = ds_along * of_s + n_along * of_n, of_left = ds_left * of_s + n_left * of_n;
        pulled[car] = own[3] * of_along - own[4] * of_left;
        pulled[cars + car] = own[4] * of_along + own[3] * of_left;
        pulled[2 * cars + car] = of[2 * cars + car];
        pulled[3 * cars + car] = -of[5 * cars + car];
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

/* cotangents of s for those of what `lookup` has found */
void pull_lookup(const float *const *tables, long rows, long count, float spacing, const float *s, const float *of,
                 float *pulled, long numbers) {{
    const float length = count * spacing;
    for (long i = 0; i < numbers; i++) {{
        float sum = 0;
        struct between b = around(s[i] - length * floorf(s[i] / length), count, spacing);
        for (long row = 0; row < rows; row++) sum += of[row * numbers + i] * (tables[row][b.next] - tables[row][b.at]);
        pulled[i] = sum / spacing;
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
        x, y, s_last = (t.to(cells.dtype).contiguous() for t in (x, y, s_last))
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
        """Return s, n, heading, offset, margin and the way from `s_last`, (6, N); differentiable."""
        given = [t.to(cells.dtype).contiguous() for t in (x, y, yaw, s_last)]
        constants = (cells.data_ptr(), cells.shape[0], spacing, reach)
        call = _Call(self.compiled, constants, (cells,), ("locate", 6), ("pull_locate", 4))
        return call(given)

    def position(self, cells: Tensor, s: Tensor, n: Tensor, spacing: float) -> tuple[Tensor, Tensor, Tensor]:
        """Return x, y and the centreline's yaw at (s, n), each (N,)."""
        s, n = s.to(cells.dtype).contiguous(), n.to(cells.dtype).contiguous()
        x, y, yaw = torch.empty_like(s), torch.empty_like(s), torch.empty_like(s)
        pointers = (t.data_ptr() for t in (s, n, x, y, yaw))
        self.compiled.position(cells.data_ptr(), cells.shape[0], spacing, *pointers, s.numel())
        return x, y, yaw

    def lookup(self, tables: Sequence[Tensor], s: Tensor, spacing: float) -> list[Tensor]:
        """Return the tables (M,) interpolated linearly and periodically at s of any shape; differentiable."""
        kept = [table.contiguous() for table in tables]
        rows = (ctypes.c_void_p * len(kept))(*(table.data_ptr() for table in kept))
        constants = (rows, len(kept), kept[0].shape[0], spacing)
        call = _Call(self.compiled, constants, kept, ("lookup", len(kept)), ("pull_lookup", 1))
        return list(call([s.to(kept[0].dtype).contiguous()]).unbind())


@dataclass(frozen=True)
class _Call:
    """A function that is compiled, and the one that pulls cotangents back through it.

    `constants` are what both are told of the track first; `kept` holds the memory that these point into. Each function
    is its name and how many rows it gives; of all numbers of the tensors that come in, each has as many in a row.
    """

    compiled: Any
    constants: tuple[Any, ...]
    kept: Sequence[Tensor]
    forth: tuple[str, int]
    back: tuple[str, int]

    def __call__(self, given: Sequence[Tensor]) -> Tensor:
        """Return the rows for tensors in single precision and one piece; differentiable."""
        if torch.is_grad_enabled() and any(each.requires_grad for each in given):
            return cast(Tensor, _Pulled.apply(self, *given))
        return self.fill(self.forth, given)

    def fill(self, function: tuple[str, int], given: Sequence[Tensor]) -> Tensor:
        """Return what one of the two functions gives, (rows, *shape of the first)."""
        name, rows = function
        out = torch.empty((rows, *given[0].shape), dtype=given[0].dtype)
        getattr(self.compiled, name)(*self.constants, *(t.data_ptr() for t in (*given, out)), given[0].numel())
        return out


class _Pulled(torch.autograd.Function):
    """A call with its gradient."""

    @staticmethod
    def forward(ctx: Any, call: _Call, *given: Tensor) -> Tensor:
        ctx.call = call
        ctx.save_for_backward(*given)
        return call.fill(call.forth, given)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *cotangents: Tensor) -> tuple[Tensor | None, ...]:
        call: _Call = ctx.call
        return None, *call.fill(call.back, (*ctx.saved_tensors, cotangents[0].contiguous())).unbind()


@functools.cache
def load_kernel(ridge: float, smallest_stretch: float) -> TrackKernel | None:
    """Build the functions, or take them from the cache; None without a compiler."""
    library = build(TEMPLATE.format(ridge=ridge, smallest=smallest_stretch))
    if library is None:
        return None
    pointer, whole, number = ctypes.c_void_p, ctypes.c_long, ctypes.c_float
    library.project.argtypes = [pointer, whole, number, whole, *[pointer] * 6, whole]
    library.locate.argtypes = [pointer, whole, number, whole, *[pointer] * 5, whole]
    library.pull_locate.argtypes = [pointer, whole, number, whole, *[pointer] * 6, whole]
    library.lookup.argtypes = [pointer, whole, whole, number, pointer, pointer, whole]
    library.pull_lookup.argtypes = [pointer, whole, whole, number, *[pointer] * 3, whole]
    library.position.argtypes = [pointer, whole, number, *[pointer] * 5, whole]
    for name in ("project", "locate", "pull_locate", "position", "lookup", "pull_lookup"):
        getattr(library, name).restype = None
    return TrackKernel(library)
