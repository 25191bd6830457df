"""The centre of gravity lies beside the middle of the axles.

Formula: M_z ← M_z − e ΣF_x.
Source: moment of the drive about the centre of gravity.
In data: the car turns to one side under power and to the other when braking, at zero steering.
Excited by: speed steps up and down on straights.
Confused with: steering_offset (without power, too), drive_split.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from racerl.vehicle.effects import Effect
from racerl.vehicle.ops import Ops, Scalar
from racerl.vehicle.parameter import parameter

if TYPE_CHECKING:
    from racerl.vehicle.vehicle import Forces, Motion, Wrench


@dataclass(frozen=True, kw_only=True)
class CogLateralOffset(Effect):
    """Lever arm of the drive."""

    offset: Scalar = parameter("m", -0.1, 0.1, "e")

    symmetric: ClassVar[bool] = False

    def wrench(self, wrench: "Wrench", forces: "Forces", motion: "Motion", ops: Ops) -> "Wrench":
        """Subtract e ΣF_x from the yaw moment."""
        return wrench._replace(M_z=wrench.M_z - self.offset * (forces.F_xf + forces.F_xr))
