"""Rolling resistance: a constant force against the rolling of the wheels.

In words: your wheels roll against a constant resistance.
Formula: F_0 tanh(v_x/0.1) against the rolling, shared by the axles as their static loads: at the front along the wheel.
Source: Milliken and Milliken 1995, section 2.8.
In data: coast-downs slow at one rate at every speed; the wheels run slightly ahead of the car at steady speed.
Excited by: coast-downs from several speeds.
Confused with: viscous_drag, aero_drag (rates that grow with speed).
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from racerl.vehicle.effects import SMOOTH_SPEED, Effect
from racerl.vehicle.ops import Ops, Scalar
from racerl.vehicle.parameter import parameter

if TYPE_CHECKING:
    from racerl.vehicle.vehicle import Forces, Motion, Wrench


@dataclass(frozen=True, kw_only=True)
class RollingResistance(Effect):
    """Constant resistance."""

    force: Scalar = parameter("N", 0.0, 50.0, "F_0")

    def wrench(self, wrench: "Wrench", forces: "Forces", motion: "Motion", ops: Ops) -> "Wrench":
        """Subtract each axle's share of F_0, the front's in the direction of its wheel."""
        car, force = motion.car, self.force * ops.tanh(motion.v_x / SMOOTH_SPEED)
        front, rear = force * (car.l_r / car.wheelbase), force * (car.arm / car.wheelbase)
        aside = front * ops.sin(motion.delta)
        return wrench._replace(
            F_x=wrench.F_x - front * ops.cos(motion.delta) - rear,
            F_y=wrench.F_y - aside,
            M_z=wrench.M_z - car.arm * aside,
        )
