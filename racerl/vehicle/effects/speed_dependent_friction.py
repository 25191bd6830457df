"""Grip falls with speed.

In words: your tyres grip less the faster they go.
Formula: μ ← μ (1 − k |v_x|), not below a tenth.
Source: friction of rubber on smooth ground over sliding speed.
In data: less lateral acceleration is reached at speed than when slow.
Excited by: equal a_y at two radii.
Confused with: lateral_load_sensitivity, downforce (of the other sign).
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from racerl.vehicle.effects import Effect, Pair, scaled
from racerl.vehicle.ops import Ops, Scalar
from racerl.vehicle.parameter import parameter

if TYPE_CHECKING:
    from racerl.vehicle.vehicle import Motion


@dataclass(frozen=True, kw_only=True)
class SpeedDependentFriction(Effect):
    """Loss of grip with speed."""

    loss: Scalar = parameter("s/m", -0.1, 0.1, "k, positive for a loss")

    def grip(self, friction: Pair, motion: "Motion", ops: Ops) -> Pair:
        """Scale the grip by 1 − k |v_x|."""
        return scaled(friction, 1.0 - self.loss * ops.abs(motion.v_x), ops)
