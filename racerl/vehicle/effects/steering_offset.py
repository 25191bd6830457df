"""The road wheels stand at an angle when the servo says zero.

In words: your steering is off centre.
Formula: δ_w = δ + δ_0.
Source: trim of the linkage.
In data: a constant curvature at zero measured steering, of the same sign at every speed.
Excited by: straights both ways.
Confused with: steering_sensor_offset (measured steering settles beside its command), mocap_yaw_misalignment (turns no
    path), camber_thrust.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from racerl.vehicle.effects import Effect
from racerl.vehicle.ops import Ops, Scalar
from racerl.vehicle.parameter import parameter


@dataclass(frozen=True, kw_only=True)
class SteeringOffset(Effect):
    """A constant added to the road-wheel angle."""

    offset: Scalar = parameter("rad", -0.2, 0.2, "δ_0, positive to the left")

    symmetric: ClassVar[bool] = False
    exact: ClassVar[bool] = True

    def steer(self, delta: Scalar, own: Mapping[str, Scalar], ops: Ops) -> Scalar:
        """Return δ + δ_0."""
        return delta + self.offset
