"""The floor is tilted.

In words: your floor is tilted.
Formula: F ← F + m g (s_x, s_y) in the world.
Source: weight on a tilted plane.
In data: the car is pulled towards one side of the room, whatever way it points.
Excited by: straights and circles in all directions.
Confused with: road_bank, rolling_resistance (against the motion).
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from racerl.vehicle.effects import Effect
from racerl.vehicle.ops import Ops, Scalar
from racerl.vehicle.parameter import parameter

if TYPE_CHECKING:
    from racerl.vehicle.vehicle import Forces, Motion, Wrench


@dataclass(frozen=True, kw_only=True)
class RoadSlope(Effect):
    """A plane, tilted in world coordinates."""

    x: Scalar = parameter("", -0.2, 0.2, "s_x, positive downhill towards +x")
    y: Scalar = parameter("", -0.2, 0.2, "s_y, positive downhill towards +y", 0.0)

    symmetric: ClassVar[bool] = False
    uniform: ClassVar[bool] = False
    exact: ClassVar[bool] = True
    vanishing: ClassVar[int] = 2

    def wrench(self, wrench: "Wrench", forces: "Forces", motion: "Motion", ops: Ops) -> "Wrench":
        """Add the weight's share along the plane, in body axes."""
        weight, sin_yaw, cos_yaw = motion.car.weight, ops.sin(motion.yaw), ops.cos(motion.yaw)
        return wrench._replace(
            F_x=wrench.F_x + weight * (self.x * cos_yaw + self.y * sin_yaw),
            F_y=wrench.F_y + weight * (self.y * cos_yaw - self.x * sin_yaw),
        )
