"""The wheels slow down with another time constant than they speed up.

In words: your wheels slow down at another pace than they speed up.
Formula: ω̇ ← ω̇/q where ω̇ < 0: T_ω is q times as long when braking.
Source: speed controllers with separate limits for motoring and braking.
In data: steps down take q times as long as steps up.
Excited by: speed steps up and down.
Confused with: regen_braking (grows with speed), current_limit (large steps only).
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from racerl.vehicle.effects import Effect
from racerl.vehicle.ops import Ops, Scalar
from racerl.vehicle.parameter import parameter

if TYPE_CHECKING:
    from racerl.vehicle.vehicle import Course


@dataclass(frozen=True, kw_only=True)
class DriveBrakeAsymmetry(Effect):
    """Ratio of the time constants of braking and driving."""

    ratio: Scalar = parameter("", 0.2, 5.0, "q")

    def drive_rate(self, rate: Scalar, course: "Course", ops: Ops) -> Scalar:
        """Return ω̇, slower by q when negative."""
        return ops.where(rate > 0.0, rate, rate / self.ratio)
