"""Tyre relaxation: the slip angle builds up over a distance.

In words: your tyres need a distance to build up side force.
Formula: α̇ = (α_ss − α)/(σ/(|v_x| + 0.1) + 3 ms) for both axles; the 3 ms keep short lengths integrable.
Source: Pacejka 2012, chapter 7 (single-contact-point transient model).
In data: lateral force and yaw rate lag the steering by a time that shrinks with speed.
Excited by: step steers at several speeds.
Confused with: steering_delay (the same time at every speed), steering_backlash.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from racerl.vehicle.effects import Effect
from racerl.vehicle.ops import Ops, Scalar
from racerl.vehicle.parameter import parameter

if TYPE_CHECKING:
    from racerl.vehicle.vehicle import Course, Motion, Slips

SHORTEST = 0.003  # s


@dataclass(frozen=True, kw_only=True)
class TyreRelaxation(Effect):
    """First-order lag of α* in both axles, over distance."""

    length: Scalar = parameter("m", 0.0, 1.0, "relaxation length σ")

    states: ClassVar[tuple[str, ...]] = ("alpha_f", "alpha_r")

    def slip(self, slips: "Slips", motion: "Motion", ops: Ops) -> "Slips":
        """Let the tyres see the lagging slip angles."""
        return slips._replace(alpha_f=motion.own[self.key("alpha_f")], alpha_r=motion.own[self.key("alpha_r")])

    def rates(self, course: "Course", ops: Ops) -> Sequence[Scalar]:
        """Return the rates of both slip angles."""
        own, lag = course.motion.own, self.length / (ops.abs(course.motion.v_x) + 0.1) + SHORTEST
        return (
            (course.steady.alpha_f - own[self.key("alpha_f")]) / lag,
            (course.steady.alpha_r - own[self.key("alpha_r")]) / lag,
        )
