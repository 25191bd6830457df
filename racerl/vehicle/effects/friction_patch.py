"""A slippery (or sticky) place on the ground.

In words: one place on your floor has another grip than the rest.
Formula: μ ← μ (1 − d/2 (1 − tanh((ρ − 1)/e))), ρ the distance from (x, y) in patch radii: a disc with a soft edge.
Source: dust, water or tape on the floor.
In data: grip differs in one place, on every pass and in both directions.
Excited by: the same place early and late, in both directions.
Confused with: friction_fade, tyre_heating.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from racerl.vehicle.effects import Effect, Pair, scaled
from racerl.vehicle.ops import Ops, Scalar
from racerl.vehicle.parameter import parameter

if TYPE_CHECKING:
    from racerl.vehicle.vehicle import Motion

TINY = 1e-6  # keeps the slope at the centre finite


@dataclass(frozen=True, kw_only=True)
class FrictionPatch(Effect):
    """Loss of grip around a place."""

    depth: Scalar = parameter("", -0.9, 0.9, "d, positive for a loss")
    x: Scalar = parameter("m", -100000.0, 100000.0, "place", 0.0)
    y: Scalar = parameter("m", -100000.0, 100000.0, "place", 0.0)
    radius: Scalar = parameter("m", 0.1, 20.0, "distance at which half of the loss is left", 1.0)
    edge: Scalar = parameter("", 0.1, 2.0, "e, width of the edge in radii", 0.5)

    uniform: ClassVar[bool] = False

    def grip(self, friction: Pair, motion: "Motion", ops: Ops) -> Pair:
        """Scale the grip by the place's."""
        across, along = (motion.x - self.x) / self.radius, (motion.y - self.y) / self.radius
        away = ops.sqrt(across * across + along * along + TINY)
        return scaled(friction, 1.0 - 0.5 * self.depth * (1.0 - ops.tanh((away - 1.0) / self.edge)), ops)
