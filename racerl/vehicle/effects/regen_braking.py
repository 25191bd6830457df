"""The motor brakes by itself while the command is below the wheel speed.

In words: your motor brakes by itself while the command is below the wheel speed.
Formula: ω̇ ← ω̇ − c ω tanh(e/w), e = max(ω − ω_ref, 0): the demand e calls on the braking up to its limit c ω.
Source: generator torque of a shorted motor, proportional to speed.
In data: slowing down starts steeper at high speed than the first-order lag foretells.
Excited by: speed steps down from several speeds.
Confused with: drive_brake_asymmetry (not with speed).
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from racerl.vehicle.effects import Effect
from racerl.vehicle.ops import Ops, Scalar
from racerl.vehicle.parameter import parameter

if TYPE_CHECKING:
    from racerl.vehicle.vehicle import Course


@dataclass(frozen=True, kw_only=True)
class RegenBraking(Effect):
    """Braking rate in proportion to speed, as far as the command asks for it."""

    rate: Scalar = parameter("1/s", 0.0, 50.0, "c")
    reach: Scalar = parameter("m/s", 0.05, 5.0, "w, demand at which most of the braking acts")

    def drive_rate(self, rate: Scalar, course: "Course", ops: Ops) -> Scalar:
        """Return ω̇ − c ω while braking."""
        drive = course.drive
        demand = ops.maximum(drive.state - drive.reference, 0.0)
        return rate - self.rate * drive.state * ops.tanh(demand / self.reach)
