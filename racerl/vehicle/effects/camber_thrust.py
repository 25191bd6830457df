"""The tyres push to one side even without slip.

In words: your car is pushed to one side even when it rolls straight.
Formula: F_y ← F_y + c F_z at both axles.
Source: Pacejka 2012, section 4.3.2 (camber, conicity and ply steer as a shift of F_y).
In data: the car drifts to one side on straights, by the same acceleration in every direction and at every speed.
Excited by: straights both ways, at several speeds.
Confused with: steering_offset (grows with the square of speed), road_bank (turns with the place),
    mocap_yaw_misalignment (no acceleration).
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from racerl.vehicle.effects import SMOOTH_SPEED, Effect
from racerl.vehicle.ops import Ops, Scalar
from racerl.vehicle.parameter import parameter

if TYPE_CHECKING:
    from racerl.vehicle.vehicle import Forces, Motion, Wrench


@dataclass(frozen=True, kw_only=True)
class CamberThrust(Effect):
    """Constant side force in shares of the load."""

    share: Scalar = parameter("", -0.2, 0.2, "c, positive to the left")

    symmetric: ClassVar[bool] = False

    def wrench(self, wrench: "Wrench", forces: "Forces", motion: "Motion", ops: Ops) -> "Wrench":
        """Add c F_z at each axle while the car rolls."""
        rolling = self.share * ops.tanh(ops.abs(motion.v_x) / SMOOTH_SPEED)
        moment = motion.car.arm * forces.F_zf - motion.car.l_r * forces.F_zr
        total = forces.F_zf + forces.F_zr
        return wrench._replace(F_y=wrench.F_y + rolling * total, M_z=wrench.M_z + rolling * moment)
