"""The markers' axis is turned against the car's.

In words: the motion capture's heading is turned against your car.
Formula: logged ψ = true ψ + ε, logged v = R(−ε) true v.
Source: definition of the rigid body in motion capture.
In data: v_y is a share of v_x, of one sign on straights, though nothing accelerates sideways.
Excited by: straights both ways.
Confused with: steering_offset (turns the path), camber_thrust.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from racerl.vehicle.effects import Effect
from racerl.vehicle.ops import Scalar
from racerl.vehicle.parameter import parameter


@dataclass(frozen=True, kw_only=True)
class MocapYawMisalignment(Effect):
    """Angle between markers and car."""

    angle: Scalar = parameter("rad", -0.2, 0.2, "ε, positive if the markers point to the left")

    symmetric: ClassVar[bool] = False
    exact: ClassVar[bool] = True

    def measure(self, channels: Mapping[str, Scalar], ops: Any) -> Mapping[str, Scalar]:
        """Return heading and velocities as the markers show them."""
        sin, cos = ops.sin(self.angle), ops.cos(self.angle)
        return {
            "yaw": channels["yaw"] + self.angle,
            "v_x": cos * channels["v_x"] + sin * channels["v_y"],
            "v_y": cos * channels["v_y"] - sin * channels["v_x"],
        }
