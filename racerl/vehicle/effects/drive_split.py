"""A differential between the axles lets them turn apart, so that each carries its share of the drive's force.

In words: your axles do not turn as one, so that each carries its own share of the drive's force.
Formula: the front axle turns at ω + Δ, the rear one at ω − Δ, Δ̇ = k v (q F_xr − (1 − q) F_xf − c Δ), k = 0.1 s/(kg m).
Source: Milliken and Milliken 1995, chapter 20: centre differentials; q = ½ for an even one, c = ∞ for locked axles.
In data: power on in a turn pulls the nose in (large q) or pushes it out, and each axle slips on its own.
Excited by: power on in turns, braking in turns.
Confused with: cog_lateral_offset, locked_differential.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from racerl.vehicle.effects import Effect
from racerl.vehicle.ops import Ops, Scalar
from racerl.vehicle.parameter import parameter

if TYPE_CHECKING:
    from racerl.vehicle.vehicle import Course, Motion, Slips

YIELD = 0.1  # k; quick beside the body, slow beside a step of the integrator
SLOWEST = 0.1  # m/s


@dataclass(frozen=True, kw_only=True)
class DriveSplit(Effect):
    """Share of the front axle in the drive's force, and what holds the axles together."""

    front: Scalar = parameter("", 0.0, 1.0, "q", 0.5)
    coupling: Scalar = parameter("N s/m", 0.0, 200.0, "c", 5.0)

    states: ClassVar[tuple[str, ...]] = ("apart",)
    vanishing: ClassVar[int] = 0

    def slip(self, slips: "Slips", motion: "Motion", ops: Ops) -> "Slips":
        """Turn the front axle faster and the rear one slower by Δ."""
        car, apart = motion.car, motion.own[self.key("apart")]
        V_xf, _ = car.front_velocity(motion, ops)
        return slips._replace(
            kappa_f=slips.kappa_f + apart / car.slip_speed(V_xf, ops),
            kappa_r=slips.kappa_r - apart / car.slip_speed(motion.v_x, ops),
        )

    def rates(self, course: "Course", ops: Ops) -> Sequence[Scalar]:
        """Let the axles give way to the force that is not their share."""
        motion, forces = course.motion, course.forces
        pull = self.front * forces.F_xr - (1.0 - self.front) * forces.F_xf
        mobility = YIELD * (ops.abs(motion.v_x) + SLOWEST)
        return (mobility * (pull - self.coupling * motion.own[self.key("apart")]),)
