"""The privileged observation: the geometric one, and by how much the car's parameters differ from its model's.

Only a simulation knows these. A policy that is told bounds what one that remembers can gain by finding out: it drives
in the same cars and has nothing to find out. Races in the car as it is modelled, and a real car, tell it zeros.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from racerl import bounds
from racerl.env.actions import Action
from racerl.env.observations import Seen
from racerl.env.observations.geometric import Geometric

if TYPE_CHECKING:
    from racerl.env.race import View


@dataclass(frozen=True)
class Privileged(Geometric):
    """State, preview and the car itself."""

    parameters: Sequence[str] = ("friction",)  # dotted names
    spread: float = 0.1  # share of its own value, by which a parameter differs where a 1 is seen

    def __post_init__(self) -> None:
        super().__post_init__()
        bounds.number("obs.spread", self.spread, 0.001, 1.0)
        names = self.parameters
        if not isinstance(names, list | tuple) or not names or not all(isinstance(name, str) for name in names):
            raise ValueError(f"parameters = {names!r}: a list of the vehicle's parameters is expected")
        object.__setattr__(self, "parameters", tuple(names))

    @property
    def size(self) -> int:
        """The geometric numbers and one of each parameter."""
        return super().size + len(self.parameters)

    def sees(self, action: Action) -> tuple[Seen, ...]:
        """Return names, units and maxima in order."""
        return (*super().sees(action), *(Seen(f"{name}_off", "", self.spread) for name in self.parameters))

    def __call__(self, view: "View") -> Tensor:
        """Return (N, 10 + 2·points + parameters)."""
        return torch.cat([super().__call__(view), view.off(self.parameters)], dim=1)
