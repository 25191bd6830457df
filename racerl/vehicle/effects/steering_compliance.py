"""The linkage gives way under the side force of the front axle.

In words: your steering gives way under the tyres' side force.
Formula: δ_w = δ − C F_y,front, where the force reaches the linkage with a lag of 10 ms.
Source: Pacejka 2012, section 1.3.4 (effective axle characteristics).
In data: less turning than the angle foretells, in proportion to the side force; front tyres seem softer.
Excited by: circles of one radius at several speeds.
Confused with: softer front tyres (alike until they saturate), steering_gain (at low speed too).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from racerl.vehicle.effects import Effect
from racerl.vehicle.ops import Ops, Scalar
from racerl.vehicle.parameter import parameter

if TYPE_CHECKING:
    from racerl.vehicle.vehicle import Course

LAG = 0.01  # s


@dataclass(frozen=True, kw_only=True)
class SteeringCompliance(Effect):
    """Angle lost per side force."""

    compliance: Scalar = parameter("rad/N", 0.0, 0.05, "C")

    states: ClassVar[tuple[str, ...]] = ("force",)

    def steer(self, delta: Scalar, own: Mapping[str, Scalar], ops: Ops) -> Scalar:
        """Return δ − C F."""
        return delta - self.compliance * own[self.key("force")]

    def rates(self, course: "Course", ops: Ops) -> Sequence[Scalar]:
        """Let the force in the linkage follow that of the front axle."""
        return ((course.forces.F_yf - course.motion.own[self.key("force")]) / LAG,)
