"""A servo of second order: it has inertia and may overshoot.

In words: your servo has inertia and may overshoot.
Formula: δ̈ = Ω² (δ_ref − δ) − 2 ζ Ω δ̇, in place of the first-order lag.
Source: position-controlled servo, any text on linear control.
In data: steps start with zero slope and, for ζ < 1, overshoot; the phase passes −90°.
Excited by: step steers, chirps to 5 Hz.
Confused with: steering_delay (equal for slow commands), steering_rate_limit (only large steps show it).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from racerl.vehicle.effects import Effect
from racerl.vehicle.ops import Ops, Scalar
from racerl.vehicle.parameter import parameter

if TYPE_CHECKING:
    from racerl.vehicle.vehicle import Course


@dataclass(frozen=True, kw_only=True)
class SteeringSecondOrder(Effect):
    """Natural frequency and damping instead of a time constant."""

    frequency: Scalar = parameter("rad/s", 5.0, 200.0, "natural frequency Ω")
    damping: Scalar = parameter("", 0.2, 3.0, "damping ratio ζ", 0.8)

    unbounded: ClassVar[tuple[str, ...]] = ("frequency", "damping")
    states: ClassVar[tuple[str, ...]] = ("rate",)

    def steering_rate(self, rate: Scalar, course: "Course", ops: Ops) -> Scalar:
        """Return this effect's own δ̇."""
        return course.motion.own[self.key("rate")]

    def rates(self, course: "Course", ops: Ops) -> Sequence[Scalar]:
        """Return δ̈."""
        servo = course.steering
        pull = self.frequency * self.frequency * (servo.reference - servo.state)
        return (pull - 2.0 * self.damping * self.frequency * course.motion.own[self.key("rate")],)
