"""The centre of gravity lies beside the middle of the axles.

In words: your car's centre of gravity lies beside the middle.
Formula: M_z ← M_z − e F_x with F_x what the tyres do along the body; the axles' middles move at v_x − e r.
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
    from racerl.vehicle.vehicle import Forces, Motion, Slips, Wrench


@dataclass(frozen=True, kw_only=True)
class CogLateralOffset(Effect):
    """Lever arm of the drive."""

    offset: Scalar = parameter("m", -0.1, 0.1, "e, positive to the right")

    symmetric: ClassVar[bool] = False
    exact: ClassVar[bool] = True

    def slip(self, slips: "Slips", motion: "Motion", ops: Ops) -> "Slips":
        """Let the axles' middles move at v_x − e r."""
        car, slower = motion.car, self.offset * motion.yaw_rate
        cos_delta, sin_delta = ops.cos(motion.delta), ops.sin(motion.delta)
        V_xf, _ = car.front_velocity(motion, ops)
        front, rear = slower / car.slip_speed(V_xf, ops), slower / car.slip_speed(motion.v_x, ops)
        return slips._replace(
            kappa_f=slips.kappa_f + front * cos_delta,
            alpha_f=slips.alpha_f - front * sin_delta,
            kappa_r=slips.kappa_r + rear,
        )

    def wrench(self, wrench: "Wrench", forces: "Forces", motion: "Motion", ops: Ops) -> "Wrench":
        """Subtract e F_x from the yaw moment."""
        ahead = motion.car.tyre_wrench(forces, motion, ops).F_x
        return wrench._replace(M_z=wrench.M_z - self.offset * ahead)
