"""Load transfer to the outer wheels costs grip: tyres gain less from load than they lose.

In words: your tyres lose grip as cornering loads the outer ones.
Formula: μ ← μ (1 − k |a_y|), a_y = v_x r as in a steady turn.
Source: Pacejka 2012, section 1.3.5; Milliken and Milliken 1995, chapter 2.
In data: grip falls as lateral acceleration grows, at equal slip.
Excited by: equal a_y at two radii, ramps to the limit.
Confused with: speed_dependent_friction (equal a_y at two radii tell), the shape of the tyre curves, roll_dynamics
    (with a delay).
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from racerl.vehicle.effects import Effect, Pair, scaled
from racerl.vehicle.ops import Ops, Scalar, soft_abs
from racerl.vehicle.parameter import parameter

if TYPE_CHECKING:
    from racerl.vehicle.vehicle import Motion


@dataclass(frozen=True, kw_only=True)
class LateralLoadSensitivity(Effect):
    """Loss of grip with lateral acceleration."""

    loss: Scalar = parameter("s²/m", 0.0, 0.1, "k")

    def grip(self, friction: Pair, motion: "Motion", ops: Ops) -> Pair:
        """Scale the grip by 1 − k |a_y|."""
        return scaled(friction, 1.0 - self.loss * soft_abs(motion.v_x * motion.yaw_rate, 0.2, ops), ops)
