"""The lateral load arrives late: the body has to roll first.

In words: your car's body rolls before its tyres feel the turn.
Formula: μ ← μ (1 − k |φ|) with φ̈ = Ω² (a_y − φ) − 2 ζ Ω φ̇, ζ = 0.5, a_y = F_y/m.
Source: Milliken and Milliken 1995, chapter 18: roll of the sprung mass.
In data: grip falls a fraction of a second after the lateral acceleration has built up.
Excited by: step steers near the limit, slalom.
Confused with: lateral_load_sensitivity (without the delay), tyre_relaxation.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from racerl.vehicle.effects import Effect, Pair, scaled
from racerl.vehicle.ops import Ops, Scalar, soft_abs
from racerl.vehicle.parameter import parameter

if TYPE_CHECKING:
    from racerl.vehicle.vehicle import Course, Motion

DAMPING = 0.5


@dataclass(frozen=True, kw_only=True)
class RollDynamics(Effect):
    """Loss of grip with lagging lateral acceleration."""

    loss: Scalar = parameter("s²/m", 0.0, 0.2, "k")
    frequency: Scalar = parameter("rad/s", 5.0, 100.0, "natural frequency Ω of the roll", 20.0)

    states: ClassVar[tuple[str, ...]] = ("roll", "rate")

    def grip(self, friction: Pair, motion: "Motion", ops: Ops) -> Pair:
        """Scale the grip by 1 − k |φ|."""
        return scaled(friction, 1.0 - self.loss * soft_abs(motion.own[self.key("roll")], 0.2, ops), ops)

    def rates(self, course: "Course", ops: Ops) -> Sequence[Scalar]:
        """Let the roll, in units of a_y, follow the tyres' side force."""
        motion = course.motion
        roll, rate = motion.own[self.key("roll")], motion.own[self.key("rate")]
        aside = motion.car.tyre_wrench(course.forces, motion, ops).F_y
        pull = self.frequency * self.frequency * (aside / motion.car.mass - roll)
        return rate, pull - 2.0 * DAMPING * self.frequency * rate
