"""Cars in the coordinates of the track: projection onto the centreline and look-ups over arc length.

A car's foot point is followed, not searched: starting from where it was, the distance to the centreline is walked
downhill to the bottom of its valley. On a regular stretch that valley stays the car's own even when another part of
the track comes closer, so a car never jumps across an infield. In a hairpin tighter than the track is wide, 1 − κn
vanishes inside the track; valleys meet there, parted by ridges of a percent, and the walk steps over those.

On the CPU in single precision the walk and the look-ups run as compiled C (`racerl.track.kernel`), places and look-ups
with their gradients; the tensors below say the same and run everywhere else.

Within a table cell the centreline is an arc of its curvature κ. With (a, b) the car relative to the cell's point,
along and left of it:  Δs = atan(κa/(1 − κb))/κ,  n = (2b − κ(a² + b²))/(1 + √((1 − κb)² + κ²a²)).
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor

from racerl.track.kernel import load_kernel
from racerl.track.track import Track

REACH = 2.0  # m of centreline searched to either side of the last foot point
RIDGE = 1.05  # a rise of the squared distance by this factor does not stop the walk
SMALLEST_STRETCH = 0.05  # lower bound on |1 − κb|, where Δs is clamped to a cell anyway


# m along the centreline; m from it, positive to the left; rad against it; m from the track's middle; m to the boundary
PLACE = ("s", "n", "heading", "offset", "margin")


class Foot(NamedTuple):
    """Where cars are on the track, each of shape (N,)."""

    s: Tensor  # m along the centreline, in [0, length)
    n: Tensor  # m, positive to the left
    yaw: Tensor  # rad, direction of the centreline


def wrap_angle(angle: Tensor) -> Tensor:
    """Return the angle in [−π, π)."""
    return torch.remainder(angle + math.pi, 2 * math.pi) - math.pi


class FrenetFrame:
    """The track's tables as tensors, for batches of cars."""

    def __init__(self, track: Track, device: torch.device | str = "cpu", dtype: torch.dtype = torch.float32) -> None:
        def table(values: object) -> Tensor:
            return torch.as_tensor(values, dtype=dtype, device=device)

        self.length = track.length
        self.spacing = track.spacing
        self.count = len(track.x)
        self.x, self.y, self.yaw = table(track.x), table(track.y), table(track.yaw)
        self.curvature, self.width_left, self.width_right = (
            table(track.curvature),
            table(track.width_left),
            table(track.width_right),
        )
        # n of the track's middle, and from there to either boundary
        self.middle = (self.width_left - self.width_right) / 2
        self.half_width = (self.width_left + self.width_right) / 2
        self._reach = min(round(REACH / self.spacing), (self.count - 1) // 2)  # in cells
        self._window = torch.arange(-self._reach, self._reach + 1, device=device)
        cpu = torch.device(device).type == "cpu" and dtype == torch.float32
        self._kernel = load_kernel(RIDGE, SMALLEST_STRETCH) if cpu else None
        # what C reads of a cell: x, y, yaw, its cosine and sine, curvature, middle, half width
        rows = [self.x, self.y, self.yaw, torch.cos(self.yaw), torch.sin(self.yaw), self.curvature]
        rows += [self.middle, self.half_width]
        self._cells = torch.stack(rows, dim=1).contiguous()

    def wrap(self, s: Tensor) -> Tensor:
        """Return s in [0, length)."""
        wrapped = torch.remainder(s, self.length)
        return torch.where(wrapped >= self.length, torch.zeros_like(wrapped), wrapped)

    def difference(self, s_to: Tensor, s_from: Tensor) -> Tensor:
        """Return the signed shortest way from one s to another, in [−length/2, length/2)."""
        return torch.remainder(s_to - s_from + self.length / 2, self.length) - self.length / 2

    def lookup(self, s: Tensor, *tables: Tensor) -> list[Tensor]:
        """Interpolate tables linearly and periodically at s of any shape."""
        if self._kernel is not None:
            return self._kernel.lookup(tables, s, self.spacing)
        position = self.wrap(s) / self.spacing
        cell = position.floor()
        share = position - cell
        index = cell.long() % self.count
        following = (index + 1) % self.count
        return [torch.lerp(table[index], table[following], share) for table in tables]

    def position(self, s: Tensor, n: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return x, y and the centreline's yaw at (s, n), exact to the arc within a cell."""
        if self._kernel is not None and not (s.requires_grad or n.requires_grad):
            return self._kernel.position(self._cells, s, n, self.spacing)
        index = (self.wrap(s) / self.spacing).round().long()
        ds = self.wrap(s) - index * self.spacing
        index = index % self.count
        kappa, yaw = self.curvature[index], self.yaw[index]
        turn = yaw + kappa * ds
        chord = ds * (1 - (kappa * ds) ** 2 / 24)
        x = self.x[index] + chord * torch.cos(yaw + kappa * ds / 2) - n * torch.sin(turn)
        y = self.y[index] + chord * torch.sin(yaw + kappa * ds / 2) + n * torch.cos(turn)
        return x, y, wrap_angle(turn)

    def project(self, x: Tensor, y: Tensor, s_last: Tensor) -> Foot:
        """Return the foot points of cars at x, y (N,) that were last at s_last (N,)."""
        if self._kernel is not None and not (x.requires_grad or y.requires_grad):
            return Foot(*self._kernel.project(self._cells, x, y, s_last, self.spacing, self._reach))
        with torch.no_grad():  # which cell it is has no slope
            nearest = (self.wrap(s_last) / self.spacing).round().long()
            window = (nearest[:, None] + self._window) % self.count
            squared = (x[:, None] - self.x[window]) ** 2 + (y[:, None] - self.y[window]) ** 2
            index = (nearest + self._downhill(squared)) % self.count
        return self._foot_in_cell(x, y, index)

    def nearest(self, x: Tensor, y: Tensor) -> Tensor:
        """Return s of the centreline's points nearest to x, y (N,), wherever on the track."""
        apart = (x[:, None] - self.x) ** 2 + (y[:, None] - self.y) ** 2
        return apart.argmin(dim=1) * self.spacing

    def locate(self, x: Tensor, y: Tensor, yaw: Tensor, s_last: Tensor) -> tuple[Tensor, Tensor]:
        """Return the places (5, N), rows as in PLACE, of cars at x, y, heading yaw (N,), and their way from s_last."""
        if self._kernel is not None:
            found = self._kernel.locate(self._cells, x, y, yaw, s_last, self.spacing, self._reach)
            return found[:5], found[5]
        foot = self.project(x, y, s_last)
        return self.place(foot.s, foot.n, wrap_angle(yaw - foot.yaw)), self.difference(foot.s, s_last)

    def place(self, s: Tensor, n: Tensor, heading: Tensor) -> Tensor:
        """Return the places (5, N) of cars at (s, n) that head so against the centreline, each (N,)."""
        middle, half_width = self.lookup(s, self.middle, self.half_width)
        offset = n - middle
        return torch.stack([s, n, heading, offset, half_width - offset.abs()])

    def _downhill(self, squared: Tensor) -> Tensor:
        """Return the steps (N,) from the middle of each row to the bottom of its valley."""
        m = self._reach
        ways = torch.stack([squared[:, m:], squared[:, : m + 1].flip(1)])  # (2, N, m + 1), ahead and behind
        passable = ways <= RIDGE * ways.cummin(dim=2).values
        blocked = passable.logical_not().cumsum(dim=2) > 0
        bottom = ways.masked_fill(blocked, torch.inf).min(dim=2)
        ahead, behind = bottom.indices
        return torch.where(bottom.values[0] <= bottom.values[1], ahead, -behind)

    def _foot_in_cell(self, x: Tensor, y: Tensor, index: Tensor) -> Foot:
        yaw, kappa = self.yaw[index], self.curvature[index]
        dx, dy = x - self.x[index], y - self.y[index]
        along = dx * torch.cos(yaw) + dy * torch.sin(yaw)
        left = dy * torch.cos(yaw) - dx * torch.sin(yaw)
        stretch = 1 - kappa * left
        slope = along / torch.where(stretch.abs() < SMALLEST_STRETCH, SMALLEST_STRETCH, stretch)
        ds = slope * (1 - (kappa * slope) ** 2 / 3)
        # beyond the centre of curvature the arc's formula points the wrong way; the cell's own point is nearest
        ds = torch.where(stretch > 0, ds.clamp(-self.spacing, self.spacing), torch.zeros_like(ds))
        arc = (2 * left - kappa * (along**2 + left**2)) / (1 + torch.hypot(stretch, kappa * along))
        # there n is the signed distance itself
        distance = torch.hypot(dx, dy) * torch.sign(left)
        n = torch.where(stretch > 0, arc, distance)
        return Foot(self.wrap(index * self.spacing + ds), n, wrap_angle(yaw + kappa * ds))
