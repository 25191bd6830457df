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

/* where the foot of (x, y), followed from `last`, is: its cell and m from there, s, n, the centreline's direction */
struct foot {{ long at; float ds, s, n, direction, stretch; }};
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
    found.ds = ds;
    found.stretch = stretch;
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

/* rows of `place`: s, n, heading against the centreline, offset from the middle, margin to the nearer boundary; and
   the way from `last` */
void locate(const float (*cells)[8], long count, float spacing, long reach, const float *x, const float *y,
            const float *yaw, const float *last, float *place, long cars) {{
    const float length = count * spacing;
    for (long car = 0; car < cars; car++) {{
        struct foot foot = foot_of(cells, count, spacing, reach, x[car], y[car], last[car]);
        float position = foot.s / spacing, cell = floorf(position), share = position - cell;
        long at = cell >= 0 && cell < count ? (long)cell : 0, next = at + 1 >= count ? 0 : at + 1;  /* NaN too */
        float offset = foot.n - (cells[at][6] + share * (cells[next][6] - cells[at][6]));
        place[car] = foot.s;
        place[cars + car] = foot.n;
        place[2 * cars + car] = wrap_angle(yaw[car] - foot.direction);
        place[3 * cars + car] = offset;
        place[4 * cars + car] = cells[at][7] + share * (cells[next][7] - cells[at][7]) - fabsf(offset);
        float way = foot.s - last[car] + length / 2;
        place[5 * cars + car] = way - length * floorf(way / length) - length / 2;
    }}
}}

/* cotangents of x, y, yaw and `last` for those of what `locate` has found:
   ds = (cos ψ dx + sin ψ dy)/(1 − κn), dn = cos ψ dy − sin ψ dx, ψ the centreline's direction and dψ = κ ds */
void pull_locate(const float (*cells)[8], long count, float spacing, long reach, const float *x, const float *y,
                 const float *yaw, const float *last, const float *of, float *pulled, long cars) {{
    for (long car = 0; car < cars; car++) {{
        struct foot foot = foot_of(cells, count, spacing, reach, x[car], y[car], last[car]);
        const float *own = cells[foot.at];
        float kappa = own[5], room = 1 - kappa * foot.n, c = cosf(foot.direction), d = sinf(foot.direction);
        room = room < SMALLEST_STRETCH ? SMALLEST_STRETCH : room;
        float rate = foot.stretch > 0 && fabsf(foot.ds) < spacing ? 1 / room : 0, n_x = -d, n_y = c;
        if (!(foot.stretch > 0)) {{  /* there n is the distance to the cell's point */
            n_x = foot.n != 0 ? (x[car] - own[0]) / foot.n : 0;
            n_y = foot.n != 0 ? (y[car] - own[1]) / foot.n : 0;
        }}
        float position = foot.s / spacing, cell = floorf(position), share = position - cell;
        long at = cell >= 0 && cell < count ? (long)cell : 0, next = at + 1 >= count ? 0 : at + 1;
        float middle = cells[next][6] - cells[at][6], half = (cells[next][7] - cells[at][7]) / spacing;
        float offset = foot.n - (cells[at][6] + share * middle);
        float of_offset = of[3 * cars + car] - (offset > 0 ? 1 : offset < 0 ? -1 : 0) * of[4 * cars + car];
        float of_n = of[cars + car] + of_offset;
        float of_s = of[car] + of[5 * cars + car] + half * of[4 * cars + car] - middle / spacing * of_offset
                     - kappa * of[2 * cars + car];
        pulled[car] = rate * c * of_s + n_x * of_n;
        pulled[cars + car] = rate * d * of_s + n_y * of_n;
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
        int index = (int)floorf((s[i] - length * floorf(s[i] / length)) / spacing);
        int at = index >= (int)count ? index - (int)count : index < 0 ? 0 : index;
        int next = at + 1 >= (int)count ? 0 : at + 1;
        for (long row = 0; row < rows; row++) sum += of[row * numbers + i] * (tables[row][next] - tables[row][at]);
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
        """Return s, n, heading, offset, margin and the way from `s_last`, (6, N); differentiable."""
        given = [t.to(cells.dtype).contiguous() for t in (x, y, yaw, s_last)]
        call = _Call(self.compiled, (cells.data_ptr(), cells.shape[0], spacing, reach))
        return cast(Tensor, _Located.apply(call, *given)) if torch.is_grad_enabled() else call.locate(given)

    def position(self, cells: Tensor, s: Tensor, n: Tensor, spacing: float) -> tuple[Tensor, Tensor, Tensor]:
        """Return x, y and the centreline's yaw at (s, n), each (N,)."""
        s, n = s.to(cells.dtype).contiguous(), n.to(cells.dtype).contiguous()
        x, y, yaw = torch.empty_like(s), torch.empty_like(s), torch.empty_like(s)
        pointers = (t.data_ptr() for t in (s, n, x, y, yaw))
        self.compiled.position(cells.data_ptr(), cells.shape[0], spacing, *pointers, s.numel())
        return x, y, yaw

    def lookup(self, tables: Sequence[Tensor], s: Tensor, spacing: float) -> list[Tensor]:
        """Return the tables (M,) interpolated linearly and periodically at s of any shape; differentiable."""
        given = s.to(tables[0].dtype).contiguous()
        rows = (ctypes.c_void_p * len(tables))(*(table.data_ptr() for table in tables))
        call = _Call(self.compiled, (rows, len(tables), tables[0].shape[0], spacing))
        found = _LookedUp.apply(call, given) if torch.is_grad_enabled() else call.lookup(given)
        return list(found.unbind())


@dataclass(frozen=True)
class _Call:
    """The compiled functions and what they are told of a track first; numbers come and go in single precision."""

    compiled: Any
    track: tuple[Any, ...]

    def locate(self, given: Sequence[Tensor]) -> Tensor:
        return self._fill("locate", 6, given, given[0].shape)

    def pull_locate(self, given: Sequence[Tensor], cotangent: Tensor) -> Tensor:
        return self._fill("pull_locate", 4, (*given, cotangent.contiguous()), given[0].shape)

    def lookup(self, s: Tensor) -> Tensor:
        return self._fill("lookup", self.track[1], (s,), s.shape)

    def pull_lookup(self, s: Tensor, cotangent: Tensor) -> Tensor:
        return self._fill("pull_lookup", 1, (s, cotangent.contiguous()), s.shape)[0]

    def _fill(self, name: str, rows: int, given: Sequence[Tensor], shape: torch.Size) -> Tensor:
        out = torch.empty((rows, *shape), dtype=given[0].dtype)
        getattr(self.compiled, name)(*self.track, *(t.data_ptr() for t in (*given, out)), given[0].numel())
        return out


class _Located(torch.autograd.Function):
    """`locate` with its gradient."""

    @staticmethod
    def forward(ctx: Any, call: _Call, *given: Tensor) -> Tensor:
        ctx.call = call
        ctx.save_for_backward(*given)
        return call.locate(given)

    @staticmethod
    def backward(ctx: Any, *cotangents: Tensor) -> tuple[Tensor | None, ...]:
        return None, *ctx.call.pull_locate(ctx.saved_tensors, cotangents[0])


class _LookedUp(torch.autograd.Function):
    """`lookup` with its gradient."""

    @staticmethod
    def forward(ctx: Any, call: _Call, s: Tensor) -> Tensor:
        ctx.call = call
        ctx.save_for_backward(s)
        return call.lookup(s)

    @staticmethod
    def backward(ctx: Any, *cotangents: Tensor) -> tuple[Tensor | None, ...]:
        return None, ctx.call.pull_lookup(*ctx.saved_tensors, cotangents[0])


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
