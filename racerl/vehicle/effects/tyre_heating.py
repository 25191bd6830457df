"""Sliding heats the tyres, and hot tyres grip less.

In words: sliding heats your tyres, and they lose grip.
Formula: μ ← μ (1 − k Θ), Θ̇ = (P/10 W − Θ)/τ, P = Σ |F · v_slip| the power lost in the contact patches.
Source: lumped heat balance of a tyre.
In data: grip falls while the car is driven hard and comes back at rest.
Excited by: hard and soft driving in turn, with a rest.
Confused with: friction_fade (no recovery), lateral_load_sensitivity (at once).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from racerl.vehicle.effects import Effect, Pair, scaled
from racerl.vehicle.ops import Ops, Scalar
from racerl.vehicle.parameter import parameter

if TYPE_CHECKING:
    from racerl.vehicle.vehicle import Course, Motion

NOMINAL = 10.0  # W


@dataclass(frozen=True, kw_only=True)
class TyreHeating(Effect):
    """Loss of grip with a temperature that follows the slip power."""

    loss: Scalar = parameter("", -2.0, 2.0, "k per 10 W of steady slip power, positive for a loss")
    time: Scalar = parameter("s", 1.0, 60.0, "τ to warm up and cool down", 20.0)

    states: ClassVar[tuple[str, ...]] = ("heat",)
    told: ClassVar[tuple[str, ...]] = states
    memory: ClassVar[tuple[str, ...]] = ("time",)
    uniform: ClassVar[bool] = False

    def grip(self, friction: Pair, motion: "Motion", ops: Ops) -> Pair:
        """Scale the grip by 1 − k Θ."""
        return scaled(friction, 1.0 - self.loss * motion.own[self.key("heat")], ops)

    def rates(self, course: "Course", ops: Ops) -> Sequence[Scalar]:
        """Return Θ̇."""
        (kappa_f, alpha_f, kappa_r, alpha_r), forces = course.steady, course.forces
        slip_power = ops.abs(forces.F_xf * kappa_f) + ops.abs(forces.F_yf * alpha_f)
        slip_power = slip_power + ops.abs(forces.F_xr * kappa_r) + ops.abs(forces.F_yr * alpha_r)
        power = slip_power * ops.abs(course.motion.v_x)
        return ((power / NOMINAL - course.motion.own[self.key("heat")]) / self.time,)
