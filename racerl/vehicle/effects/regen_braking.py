"""The motor brakes by itself while the command is below the wheel speed.

Formula: ω̇ ← ω̇ − c ω where ω_ref < ω, blended over 0.1 m/s.
Source: generator torque of a shorted motor, proportional to speed.
In data: slowing down starts steeper at high speed than the first-order lag foretells.
Excited by: speed steps down from several speeds.
Confused with: drive_brake_asymmetry (not with speed).
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from racerl.vehicle.effects import SMOOTH_SPEED, Effect
from racerl.vehicle.ops import Ops, Scalar
from racerl.vehicle.parameter import parameter

if TYPE_CHECKING:
    from racerl.vehicle.vehicle import Course


@dataclass(frozen=True, kw_only=True)
class RegenBraking(Effect):
    """Braking rate in proportion to speed."""

    rate: Scalar = parameter("1/s", 0.0, 20.0, "c")

    def drive_rate(self, rate: Scalar, course: "Course", ops: Ops) -> Scalar:
        """Return ω̇ − c ω while braking."""
        speed, reference, _ = course.drive
        braking = 0.5 * (1.0 + ops.tanh((speed - reference) / SMOOTH_SPEED))
        return rate - self.rate * speed * braking
