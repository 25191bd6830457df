"""The linkage is progressive or degressive.

In words: your steering is not proportional to its command.
Formula: δ_w = δ + c δ³.
Source: Ackermann linkage and servo horn geometry.
In data: large angles turn the car more (c > 0) or less than small ones foretell.
Excited by: circles of many radii at low speed, a ramp to full lock.
Confused with: steering_saturation (only at the stop), steering_gain (small angles).
"""

from collections.abc import Mapping
from dataclasses import dataclass

from racerl.vehicle.effects import Effect
from racerl.vehicle.ops import Ops, Scalar
from racerl.vehicle.parameter import parameter


@dataclass(frozen=True, kw_only=True)
class SteeringNonlinearity(Effect):
    """Cubic term between steering angle and road wheels."""

    cubic: Scalar = parameter("1/rad²", -10.0, 10.0, "c")

    def steer(self, delta: Scalar, own: Mapping[str, Scalar], ops: Ops) -> Scalar:
        """Return δ + c δ³."""
        return delta + self.cubic * delta * delta * delta
