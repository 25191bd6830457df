"""The servo turns no faster than R.

In words: your servo turns no faster than a limit.
Formula: |δ̇| ≤ R, with a rounded corner.
Source: no-load speed of a servo (s per 60° of its data sheet).
In data: large steps are ramps of one slope, small ones exponentials.
Excited by: step steers of three sizes.
Confused with: steering_second_order, a longer time constant (small steps tell).
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from racerl.vehicle.effects import Effect
from racerl.vehicle.ops import Ops, Scalar, soft_clip
from racerl.vehicle.parameter import parameter

if TYPE_CHECKING:
    from racerl.vehicle.vehicle import Course


@dataclass(frozen=True, kw_only=True)
class SteeringRateLimit(Effect):
    """Largest steering rate."""

    limit: Scalar = parameter("rad/s", 0.2, 50.0, "R")

    unbounded: ClassVar[tuple[str, ...]] = ("limit",)

    def steering_rate(self, rate: Scalar, course: "Course", ops: Ops) -> Scalar:
        """Return δ̇ within ± R."""
        return soft_clip(rate, self.limit, ops)
