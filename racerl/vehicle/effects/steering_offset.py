"""Steering offset: the road wheels stand at δ + δ_0 when the servo says δ.

In data: a constant curvature at zero measured steering, of the same sign at every speed. Excited by straights in both
directions; confused with a yaw misalignment of the motion capture when only one direction is driven.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from racerl.vehicle.effects import Effect
from racerl.vehicle.ops import Ops, Scalar
from racerl.vehicle.parameter import parameter


@dataclass(frozen=True, kw_only=True)
class SteeringOffset(Effect):
    """A constant added to the road-wheel angle."""

    offset: Scalar = parameter("rad", -0.2, 0.2, "δ_0, positive to the left")

    def steer(self, delta: Scalar, own: Mapping[str, Scalar], ops: Ops) -> Scalar:
        """Return δ + δ_0."""
        return delta + self.offset
