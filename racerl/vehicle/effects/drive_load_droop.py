"""The wheels fall behind their reference under load.

In words: your wheels fall behind the command under load.
Formula: ω̇ ← ω̇ − k ΣF_x.
Source: proportional speed control without an integral term.
In data: wheel speed falls short while the car accelerates or climbs, and overshoots while it brakes.
Excited by: speed steps, power on in turns.
Confused with: battery_sag (over time), a longer time constant.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from racerl.vehicle.effects import Effect
from racerl.vehicle.ops import Ops, Scalar
from racerl.vehicle.parameter import parameter

if TYPE_CHECKING:
    from racerl.vehicle.vehicle import Course


@dataclass(frozen=True, kw_only=True)
class DriveLoadDroop(Effect):
    """Loss of wheel acceleration per tyre force."""

    droop: Scalar = parameter("1/kg", 0.0, 5.0, "k, in m/s² per N")

    def drive_rate(self, rate: Scalar, course: "Course", ops: Ops) -> Scalar:
        """Return ω̇ − k ΣF_x."""
        return rate - self.droop * (course.forces.F_xf + course.forces.F_xr)
