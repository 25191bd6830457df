"""Play between servo and linkage: the road wheels rest until the servo has crossed the gap.

In words: your steering has play.
Formula: the linkage's angle stays within δ ± b/2 and moves only when pushed; a lag of 6 ms makes the push smooth.
Source: the play operator of mechanics.
In data: after each reversal of the steering, the yaw rate waits for a change of b of the measured angle.
Excited by: slow steering to and fro about several angles, slalom.
Confused with: steering_deadband (shows in the measured angle, play does not), tyre_relaxation.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from racerl.vehicle.effects import Effect
from racerl.vehicle.ops import Ops, Scalar
from racerl.vehicle.parameter import parameter

if TYPE_CHECKING:
    from racerl.vehicle.vehicle import Course

PUSH = 150.0  # 1/s, rate at which the remembered angle follows the pushed one


@dataclass(frozen=True, kw_only=True)
class SteeringBacklash(Effect):
    """Play between measured angle and road wheels."""

    play: Scalar = parameter("rad", 0.0, 0.2, "b, the whole gap")

    states: ClassVar[tuple[str, ...]] = ("wheel",)

    def link(self, delta: Scalar, own: Mapping[str, Scalar], ops: Ops) -> Scalar:
        """Return the angle where the linkage was left, no further than b/2 from δ."""
        left = own[self.key("wheel")]
        return ops.minimum(ops.maximum(left, delta - 0.5 * self.play), delta + 0.5 * self.play)

    def rates(self, course: "Course", ops: Ops) -> Sequence[Scalar]:
        """Return the rate at which the pushed linkage moves."""
        own = course.motion.own
        return (PUSH * (self.link(course.steering.position, own, ops) - own[self.key("wheel")]),)
