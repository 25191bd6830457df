"""Grip is lost over time.

Formula: μ ← μ (1 − k t), not below a tenth.
Source: wear and dust; a line over one drive.
In data: the same manoeuvre shows less grip late than early, a rest does not bring it back.
Excited by: the same manoeuvres early and late.
Confused with: tyre_heating (a rest brings grip back), friction_patch (the same place tells), battery_sag (speed, not
    grip).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from racerl.vehicle.effects import Effect, Pair
from racerl.vehicle.ops import Ops, Scalar
from racerl.vehicle.parameter import parameter

if TYPE_CHECKING:
    from racerl.vehicle.vehicle import Course, Motion


@dataclass(frozen=True, kw_only=True)
class FrictionFade(Effect):
    """Loss of grip over time."""

    rate: Scalar = parameter("1/s", -0.005, 0.005, "k, positive for a loss")

    states: ClassVar[tuple[str, ...]] = ("clock",)
    told: ClassVar[tuple[str, ...]] = states
    uniform: ClassVar[bool] = False

    def grip(self, friction: Pair, motion: "Motion", ops: Ops) -> Pair:
        """Scale the grip by 1 − k t."""
        left = ops.maximum(1.0 - self.rate * motion.own[self.key("clock")], 0.1)
        return friction[0] * left, friction[1] * left

    def rates(self, course: "Course", ops: Ops) -> Sequence[Scalar]:
        """Return the rate of time."""
        return (1.0 + 0.0 * course.motion.v_x,)
