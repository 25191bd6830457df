"""The motor has the less torque the faster it turns.

In words: your motor loses torque the faster it turns.
Formula: ω̇ ≤ a_0 (1 − ω/ω_0).
Source: torque line of a DC motor at full voltage.
In data: the steepest speeding up falls in a line with speed; slowing down is not affected.
Excited by: large speed steps up, from several speeds.
Confused with: current_limit (the same at every speed), battery_sag.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from racerl.vehicle.effects import Effect
from racerl.vehicle.ops import Ops, Scalar
from racerl.vehicle.parameter import parameter

if TYPE_CHECKING:
    from racerl.vehicle.vehicle import Course


@dataclass(frozen=True, kw_only=True)
class BackEmf(Effect):
    """Falling limit of the wheels' acceleration."""

    stall: Scalar = parameter("m/s²", 1.0, 200.0, "a_0")
    top_speed: Scalar = parameter("m/s", 1.0, 50.0, "ω_0")

    unbounded: ClassVar[tuple[str, ...]] = ("stall", "top_speed")

    def drive_rate(self, rate: Scalar, course: "Course", ops: Ops) -> Scalar:
        """Return ω̇ below the motor's line."""
        return ops.minimum(rate, self.stall * (1.0 - course.drive.state / self.top_speed))
