"""The floor leans towards the inside of the course, or away from it.

In words: your floor leans across the course.
Formula: F ← F − m g β e_r: the weight's share towards (x, y), the middle of the course, rounded within 1 m of it.
Source: weight on a bowl: banked turns.
In data: the car is pulled inwards (β > 0) or outwards, whatever way round it drives.
Excited by: laps both ways round.
Confused with: camber_thrust (turns with the car), road_slope (one direction in the world).
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from racerl.vehicle.effects import Effect
from racerl.vehicle.ops import Ops, Scalar
from racerl.vehicle.parameter import parameter

if TYPE_CHECKING:
    from racerl.vehicle.vehicle import Forces, Motion, Wrench


@dataclass(frozen=True, kw_only=True)
class RoadBank(Effect):
    """A bowl around a place."""

    bank: Scalar = parameter("", -0.2, 0.2, "β, positive if the outside is higher")
    x: Scalar = parameter("m", -100000.0, 100000.0, "middle", 0.0)
    y: Scalar = parameter("m", -100000.0, 100000.0, "middle", 0.0)

    symmetric: ClassVar[bool] = False
    uniform: ClassVar[bool] = False

    def wrench(self, wrench: "Wrench", forces: "Forces", motion: "Motion", ops: Ops) -> "Wrench":
        """Add the weight's share along the bowl, in body axes."""
        away_x, away_y = motion.x - self.x, motion.y - self.y
        pull = motion.car.weight * self.bank / ops.sqrt(away_x * away_x + away_y * away_y + 1.0)
        sin_yaw, cos_yaw = ops.sin(motion.yaw), ops.cos(motion.yaw)
        return wrench._replace(
            F_x=wrench.F_x - pull * (away_x * cos_yaw + away_y * sin_yaw),
            F_y=wrench.F_y - pull * (away_y * cos_yaw - away_x * sin_yaw),
        )
