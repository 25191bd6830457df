"""The servo does not answer errors below d.

In words: your servo ignores small errors.
Formula: δ̇ ← δ̇ · g(|δ_ref − δ|), where g rises from 0 to 1 about d.
Source: dead band of hobby servos.
In data: the measured angle stops up to d short of the command, on the side it came from.
Excited by: small and slow steering commands, ramps.
Confused with: steering_backlash (does not show in the measured angle), steering_gain.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from racerl.vehicle.effects import Effect
from racerl.vehicle.ops import Ops, Scalar
from racerl.vehicle.parameter import parameter

if TYPE_CHECKING:
    from racerl.vehicle.vehicle import Course

EDGE = 0.2  # of the width, over which the gate opens
TINY = 1e-4  # rad


@dataclass(frozen=True, kw_only=True)
class SteeringDeadband(Effect):
    """Smallest error that the servo answers."""

    width: Scalar = parameter("rad", 0.0, 0.1, "d")

    def steering_rate(self, rate: Scalar, course: "Course", ops: Ops) -> Scalar:
        """Return δ̇, gated."""
        error = ops.abs(course.steering.reference - course.steering.state)
        return rate * 0.5 * (1.0 + ops.tanh((error - self.width) / (EDGE * self.width + TINY)))
