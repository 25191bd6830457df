"""The linkage turns the wheels further to one side than to the other.

In words: your steering turns the wheels further to one side than to the other.
Formula: δ_w = δ (1 + a) to the left, δ (1 − a) to the right.
Source: servo horn off its neutral angle.
In data: equal angles give tighter circles on one side.
Excited by: circles both ways.
Confused with: steering_offset (the same at every angle).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from racerl.vehicle.effects import Effect
from racerl.vehicle.ops import Ops, Scalar, soft_abs
from racerl.vehicle.parameter import parameter


@dataclass(frozen=True, kw_only=True)
class SteeringGainAsymmetry(Effect):
    """Gain that differs between left and right."""

    asymmetry: Scalar = parameter("", -0.5, 0.5, "a, positive if left is stronger")

    symmetric: ClassVar[bool] = False

    def steer(self, delta: Scalar, own: Mapping[str, Scalar], ops: Ops) -> Scalar:
        """Return δ + a |δ|."""
        return delta + self.asymmetry * soft_abs(delta, 0.005, ops)
