"""Braking loads the front axle, driving the rear.

In words: your car's weight moves forward when it brakes and back when it speeds up.
Formula: F_z,front ← F_z,front − m a_x h/L, F_z,rear ← F_z,rear + m a_x h/L; the body pitches with a lag of 20 ms.
Source: Milliken and Milliken 1995, chapter 18.
In data: the nose grips more under braking, the tail under power, in turns above all.
Excited by: braking and power on in turns.
Confused with: drive_split, cog_longitudinal_offset (without a_x).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from racerl.vehicle.effects import Effect, Pair
from racerl.vehicle.ops import Ops, Scalar
from racerl.vehicle.parameter import parameter

if TYPE_CHECKING:
    from racerl.vehicle.vehicle import Course, Motion

LAG = 0.02  # s, of the pitch


@dataclass(frozen=True, kw_only=True)
class LongitudinalLoadTransfer(Effect):
    """Load transfer between the axles."""

    height: Scalar = parameter("m", 0.0, 0.5, "h of the centre of gravity")

    states: ClassVar[tuple[str, ...]] = ("acceleration",)

    def loads(self, F_z: Pair, motion: "Motion", ops: Ops) -> Pair:
        """Shift m a_x h/L from the front axle to the rear, and no more than leaves a tenth of a load."""
        share = self.height * motion.own[self.key("acceleration")] * motion.car.mass / motion.car.wheelbase
        shift = ops.maximum(ops.minimum(share, 0.9 * F_z[0]), -0.9 * F_z[1])
        return F_z[0] - shift, F_z[1] + shift

    def rates(self, course: "Course", ops: Ops) -> Sequence[Scalar]:
        """Let the pitch follow the acceleration that the tyres give."""
        motion = course.motion
        ahead = motion.car.tyre_wrench(course.forces, motion, ops).F_x
        return ((ahead / motion.car.mass - motion.own[self.key("acceleration")]) / LAG,)
