"""Sliding heats the tyres, and hot tyres grip less.

Formula: μ ← μ (1 − k tanh(Θ/P_s)), Θ̇ = (P − Θ)/τ, P = Σ |F · v_slip| the power lost in the contact patches.
Source: lumped heat balance of a tyre; hot rubber grips less, and hotter rubber not much less again.
In data: grip falls while the car is driven hard, to a level, and comes back at rest.
Excited by: hard and soft driving in turn, with a rest.
Confused with: friction_fade (no recovery), lateral_load_sensitivity (at once).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from racerl.vehicle.effects import Effect, Pair
from racerl.vehicle.ops import Ops, Scalar
from racerl.vehicle.parameter import parameter

if TYPE_CHECKING:
    from racerl.vehicle.vehicle import Course, Motion


@dataclass(frozen=True, kw_only=True)
class TyreHeating(Effect):
    """Loss of grip with a temperature that follows the slip power."""

    loss: Scalar = parameter("", -0.9, 0.9, "k of tyres that are hot through, positive for a loss")
    power: Scalar = parameter("W", 0.5, 500.0, "P_s that heats them through", 5.0)
    time: Scalar = parameter("s", 1.0, 200.0, "τ to warm up and cool down", 20.0)

    states: ClassVar[tuple[str, ...]] = ("heat",)
    memory: ClassVar[tuple[str, ...]] = ("time",)
    uniform: ClassVar[bool] = False

    def grip(self, friction: Pair, motion: "Motion", ops: Ops) -> Pair:
        """Scale the grip by 1 − k tanh(Θ/P_s)."""
        left = 1.0 - self.loss * ops.tanh(motion.own[self.key("heat")] / self.power)
        return friction[0] * left, friction[1] * left

    def rates(self, course: "Course", ops: Ops) -> Sequence[Scalar]:
        """Return Θ̇."""
        (kappa_f, alpha_f, kappa_r, alpha_r), forces = course.steady, course.forces
        slip_power = ops.abs(forces.F_xf * kappa_f) + ops.abs(forces.F_yf * alpha_f)
        slip_power = slip_power + ops.abs(forces.F_xr * kappa_r) + ops.abs(forces.F_yr * alpha_r)
        power = slip_power * ops.abs(course.motion.v_x)
        return ((power - course.motion.own[self.key("heat")]) / self.time,)
