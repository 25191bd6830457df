"""The progress observation: n, u, v_x, v_y, r, δ, δ_ref, ω̇_ref, ω_ref, ω and the place s on the track.

The track itself is not shown; the policy has to learn it by heart.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from racerl.env.observations import HEADING_MAX, SPEED_MAX, YAW_RATE_MAX, actuator_terms

if TYPE_CHECKING:
    from racerl.env.race import Race


@dataclass(frozen=True)
class Progress:
    """State and place on the track."""

    @property
    def size(self) -> int:
        """11 numbers."""
        return 11

    def __call__(self, race: "Race") -> Tensor:
        """Return (N, 11)."""
        terms = [
            race.offset / race.track.max_half_width,
            race.heading / HEADING_MAX,
            race.v_x / SPEED_MAX,
            race.v_y / SPEED_MAX,
            race.yaw_rate / YAW_RATE_MAX,
            *actuator_terms(race),
            race.s / race.track.length,
        ]
        return torch.stack(terms, dim=1)
