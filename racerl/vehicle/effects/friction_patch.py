"""A slippery (or sticky) place on the ground.

Formula: μ ← μ (1 − d e^(−ρ²/2)), ρ the distance from (x, y) in patch radii.
Source: dust, water or tape on the floor.
In data: grip differs in one place, on every pass and in both directions.
Excited by: the same place early and late, in both directions.
Confused with: friction_fade, tyre_heating.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from racerl.vehicle.effects import Effect, Pair
from racerl.vehicle.ops import Ops, Scalar
from racerl.vehicle.parameter import parameter

if TYPE_CHECKING:
    from racerl.vehicle.vehicle import Motion


@dataclass(frozen=True, kw_only=True)
class FrictionPatch(Effect):
    """Loss of grip around a place."""

    depth: Scalar = parameter("", -0.9, 0.9, "d, positive for a loss")
    x: Scalar = parameter("m", -100000.0, 100000.0, "place", 0.0)
    y: Scalar = parameter("m", -100000.0, 100000.0, "place", 0.0)
    radius: Scalar = parameter("m", 0.1, 20.0, "distance over which the loss falls by 40 %", 1.0)

    uniform: ClassVar[bool] = False

    def grip(self, friction: Pair, motion: "Motion", ops: Ops) -> Pair:
        """Scale the grip by the place's."""
        across, along = (motion.x - self.x) / self.radius, (motion.y - self.y) / self.radius
        left = 1.0 - self.depth * ops.exp(-0.5 * (across * across + along * along))
        return friction[0] * left, friction[1] * left
