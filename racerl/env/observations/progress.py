"""The progress observation: n, u, v_x, v_y, r, δ, δ_ref, ω̇_ref, ω_ref, ω and the place s on the track.

The track itself is not shown; the policy has to learn it by heart.
"""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from racerl.env.actions import Action
from racerl.env.observations import HEADING, V_X, V_Y, YAW_RATE, Seen, actuator_terms, actuators_seen, check_maxima
from racerl.errors import ConfigError
from racerl.track.track import Track

if TYPE_CHECKING:
    from racerl.env.race import View


@dataclass(frozen=True)
class Progress:
    """State and place on the track."""

    length: float = 0.0  # m; 0: the track's
    width_max: float = 0.0  # m, of the half-width; 0: the track's

    def __post_init__(self) -> None:
        check_maxima(length=self.length, width_max=self.width_max)

    @property
    def memory(self) -> int:
        """It looks at the present only."""
        return 0

    @property
    def size(self) -> int:
        """11 numbers."""
        return 11

    def fitted(self, *tracks: Track) -> "Progress":
        """Take missing maxima from the track; ConfigError for several, as a place is on one."""
        if len(tracks) > 1:
            raise ConfigError(f"obs=progress sees its place on one track, {len(tracks)} are given; use obs=geometric")
        (track,) = tracks
        return replace(self, length=self.length or track.length, width_max=self.width_max or track.max_half_width)

    def sees(self, action: Action) -> tuple[Seen, ...]:
        """Return names, units and maxima in order."""
        return (
            Seen("n", "m", self.width_max),
            HEADING,
            V_X,
            V_Y,
            YAW_RATE,
            *actuators_seen(action),
            Seen("s", "m", self.length),
        )

    def __call__(self, view: "View") -> Tensor:
        """Return (N, 11)."""
        terms = [view.offset, view.heading, view.v_x, view.v_y, view.yaw_rate, *actuator_terms(view), view.s]
        return torch.stack(terms, dim=1)
