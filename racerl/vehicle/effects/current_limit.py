"""The motor's current, and with it the wheels' acceleration, is limited.

In words: the motor's current limits how hard your car speeds up and brakes.
Formula: |ω̇| ≤ a_max, with a rounded corner.
Source: current limit of the motor controller.
In data: large speed steps are ramps of one slope.
Excited by: speed steps of several sizes.
Confused with: back_emf (the slope falls with speed), a longer time constant (small steps tell).
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from racerl.vehicle.effects import Effect
from racerl.vehicle.ops import Ops, Scalar, soft_clip
from racerl.vehicle.parameter import parameter

if TYPE_CHECKING:
    from racerl.vehicle.vehicle import Course


@dataclass(frozen=True, kw_only=True)
class CurrentLimit(Effect):
    """Largest acceleration of the wheels."""

    limit: Scalar = parameter("m/s²", 0.5, 200.0, "a_max")

    unbounded: ClassVar[tuple[str, ...]] = ("limit",)

    def drive_rate(self, rate: Scalar, course: "Course", ops: Ops) -> Scalar:
        """Return ω̇ within ± a_max."""
        return soft_clip(rate, self.limit, ops)
