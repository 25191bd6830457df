"""The geometric observation: the car's state and the track ahead as curvatures and widths.

v_x, v_y, u, n, r, δ, δ_ref, ω̇_ref, ω_ref, ω, then curvature and half-width at `points` places `spacing` metres apart,
the first one `spacing` ahead. u is the heading relative to the track, n the offset from the middle of the track.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from racerl import bounds
from racerl.env.actions import Action
from racerl.env.observations import HEADING, V_X, V_Y, YAW_RATE, Seen, actuator_terms, actuators_seen, check_maxima
from racerl.track.track import Track

if TYPE_CHECKING:
    from racerl.env.race import View


@dataclass(frozen=True)
class Geometric:
    """State and preview; independent of where on the track the car is."""

    points: int = 20
    spacing: float = 0.3  # m
    curvature_max: float = 0.0  # 1/m; 0: the track's
    width_max: float = 0.0  # m, of the half-width; 0: the track's

    def __post_init__(self) -> None:
        check_maxima(curvature_max=self.curvature_max, width_max=self.width_max)
        bounds.whole("obs.points", self.points, 1, 500)
        bounds.number("obs.spacing", self.spacing, 0.01, 50.0, "m")

    @property
    def memory(self) -> int:
        """It looks at the present only."""
        return 0

    @property
    def size(self) -> int:
        """10 numbers of the car and two per preview point."""
        return 10 + 2 * self.points

    def fitted(self, *tracks: Track) -> "Geometric":
        """Take missing maxima from the tracks."""
        return replace(
            self,
            curvature_max=self.curvature_max or max(1e-3, *(track.max_curvature for track in tracks)),
            width_max=self.width_max or max(track.max_half_width for track in tracks),
        )

    def sees(self, action: Action) -> tuple[Seen, ...]:
        """Return names, units and maxima in order."""
        return (
            V_X,
            V_Y,
            HEADING,
            Seen("n", "m", self.width_max),
            YAW_RATE,
            *actuators_seen(action),
            *(Seen(f"curvature_{i + 1}", "1/m", self.curvature_max) for i in range(self.points)),
            *(Seen(f"half_width_{i + 1}", "m", self.width_max) for i in range(self.points)),
        )

    def __call__(self, view: "View") -> Tensor:
        """Return (N, 10 + 2·points)."""
        frame = view.frame
        car = [view.v_x, view.v_y, view.heading, view.offset, view.yaw_rate, *actuator_terms(view)]
        ahead = view.s[:, None] + view.constant(self._places)
        preview = frame.lookup(ahead, frame.curvature, frame.half_width)
        return torch.cat([torch.stack(car, dim=1), *preview], dim=1)

    @cached_property
    def _places(self) -> tuple[float, ...]:
        """Distances ahead, in m."""
        return tuple(self.spacing * (i + 1) for i in range(self.points))
