"""The centre of gravity lies further ahead than weighed.

In words: your car's centre of gravity lies elsewhere than weighed.
Formula: l_f ← l_f − e, l_r ← l_r + e.
Source: weighing with other equipment on board.
In data: the balance between the axles differs, in loads and in lever arms.
Excited by: circles both ways up to the limit.
Confused with: tyres of other stiffness on one axle, lever_arm (rotation about a known point tells).
"""

from dataclasses import dataclass
from typing import ClassVar

from racerl.vehicle.effects import Effect
from racerl.vehicle.ops import Scalar
from racerl.vehicle.parameter import parameter


@dataclass(frozen=True, kw_only=True)
class CogLongitudinalOffset(Effect):
    """Shift of the centre of gravity."""

    offset: Scalar = parameter("m", -0.1, 0.1, "e, positive ahead")

    exact: ClassVar[bool] = True

    def arm(self, l_f: Scalar) -> Scalar:
        """Return l_f − e."""
        return l_f - self.offset
