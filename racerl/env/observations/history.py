"""The history observation: the geometric one, and what the car did on the control steps before.

For each of `steps` steps, the latest first: v_x, v_y, r, δ, ω and the references given then, δ_ref and the drive's.
How a car answers its references shows in them, so that a policy may tell cars apart that look alike at an instant.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from racerl.env import memory
from racerl.env.actions import Action
from racerl.env.observations import V_X, V_Y, YAW_RATE, Seen, actuators_seen
from racerl.env.observations.geometric import Geometric

if TYPE_CHECKING:
    from racerl.env.race import View


@dataclass(frozen=True)
class History(Geometric):
    """State, preview and past."""

    steps: int = 10  # control steps

    def __post_init__(self) -> None:
        super().__post_init__()
        if not isinstance(self.steps, int) or not 1 <= self.steps <= 200:
            raise ValueError(f"steps = {self.steps!r}: allowed is 1 … 200 control steps")

    @property
    def memory(self) -> int:
        """Control steps that are looked back."""
        return self.steps

    @property
    def size(self) -> int:
        """The geometric numbers and seven for each step."""
        return super().size + memory.SIZE * self.steps

    def sees(self, action: Action) -> tuple[Seen, ...]:
        """Return names, units and maxima in order."""
        delta, delta_ref, _, drive_ref, omega = actuators_seen(action)
        row = (V_X, V_Y, YAW_RATE, delta, omega, delta_ref, drive_ref)
        past = (each._replace(name=f"{each.name}_{i + 1}_ago") for i in range(self.steps) for each in row)
        return (*super().sees(action), *past)

    def __call__(self, view: "View") -> Tensor:
        """Return (N, 10 + 2·points + 7·steps)."""
        return torch.cat([super().__call__(view), view.past.flatten(0, 1).T], dim=1)
