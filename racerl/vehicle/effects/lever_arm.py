"""The tracked point lies beside the centre of gravity.

In words: the point that is tracked is not your car's centre of gravity.
Formula: logged (x, y) = true (x, y) + R(ψ) (a, b), logged v = true v + r (−b, a).
Source: kinematics of a rigid body.
In data: v_y shows a share of the yaw rate, v_x a share of it in turns; the pose swings about the true one.
Excited by: circles both ways, rotation about a known point.
Confused with: cog_longitudinal_offset (changes the balance, too).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from racerl.vehicle.effects import Effect
from racerl.vehicle.ops import Scalar
from racerl.vehicle.parameter import parameter


@dataclass(frozen=True, kw_only=True)
class LeverArm(Effect):
    """Place of the tracked point in body axes."""

    forward: Scalar = parameter("m", -0.5, 0.5, "a, positive ahead of the centre of gravity")
    left: Scalar = parameter("m", -0.5, 0.5, "b, positive to the left of it", 0.0)

    symmetric: ClassVar[bool] = False
    exact: ClassVar[bool] = True
    vanishing: ClassVar[int] = 2

    def measure(self, channels: Mapping[str, Scalar], ops: Any) -> Mapping[str, Scalar]:
        """Return pose and velocities of the tracked point."""
        sin_yaw, cos_yaw, r = ops.sin(channels["yaw"]), ops.cos(channels["yaw"]), channels["yaw_rate"]
        return {
            "x": channels["x"] + self.forward * cos_yaw - self.left * sin_yaw,
            "y": channels["y"] + self.forward * sin_yaw + self.left * cos_yaw,
            "v_x": channels["v_x"] - self.left * r,
            "v_y": channels["v_y"] + self.forward * r,
        }
