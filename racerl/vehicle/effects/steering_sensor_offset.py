"""The steering sensor shows an angle at straight wheels.

In words: your steering sensor is off centre.
Formula: logged δ = true δ + b.
Source: zero of a potentiometer.
In data: measured steering settles beside its command, and the car drives straight at a measured angle b.
Excited by: straights both ways, steady commands.
Confused with: steering_offset (measured steering settles at its command).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from racerl.vehicle.effects import Effect
from racerl.vehicle.ops import Scalar
from racerl.vehicle.parameter import parameter


@dataclass(frozen=True, kw_only=True)
class SteeringSensorOffset(Effect):
    """Offset of the measured steering angle."""

    offset: Scalar = parameter("rad", -0.2, 0.2, "b, positive to the left")

    symmetric: ClassVar[bool] = False
    exact: ClassVar[bool] = True

    def measure(self, channels: Mapping[str, Scalar], ops: Any) -> Mapping[str, Scalar]:
        """Return δ + b."""
        return {"delta": channels["delta"] + self.offset}
