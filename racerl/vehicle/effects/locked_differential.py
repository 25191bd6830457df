"""Left and right wheels turn at one speed: in a turn the inner one drives, the outer one brakes.

In words: your left and right wheels turn at one speed, which resists turning.
Formula: M_z = −(w/4) Σ_axles [F_x(κ + Δ) − F_x(κ − Δ)], Δ = w r/(2V), with half of an axle's force at each wheel.
Source: Milliken and Milliken 1995, chapter 20: the yaw moment of a spool.
In data: turns are wider at low speed than the tyres foretell, less so at high speed and when the tyres slide.
Excited by: equal yaw rates at two speeds, power on and off.
Confused with: yaw_damping (not with 1/V), steering_gain.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from racerl.vehicle.effects import Effect
from racerl.vehicle.ops import Ops, Scalar
from racerl.vehicle.parameter import parameter

if TYPE_CHECKING:
    from racerl.vehicle.vehicle import Forces, Motion, Wrench


@dataclass(frozen=True, kw_only=True)
class LockedDifferential(Effect):
    """Yaw moment against the turn, by the tyres' own longitudinal slip."""

    track_width: Scalar = parameter("m", 0.0, 3.0, "w, distance between left and right wheels")

    def wrench(self, wrench: "Wrench", forces: "Forces", motion: "Motion", ops: Ops) -> "Wrench":
        """Subtract both axles' moments from the yaw moment."""
        car = motion.car
        slips, friction = car.slips_seen(car.slips(motion, ops), motion, ops), car.grip(motion, ops)
        apart = 0.5 * self.track_width * motion.yaw_rate / car.slip_speed(motion.v_x, ops)
        M_z = wrench.M_z
        axles = (
            (car.front, slips.kappa_f, slips.alpha_f, forces.F_zf, friction[0]),
            (car.rear, slips.kappa_r, slips.alpha_r, forces.F_zr, friction[1]),
        )
        for tyre, kappa, alpha, F_z, grip in axles:
            inner, outer = (tyre.forces(kappa + side * apart, alpha, F_z, grip, ops)[0] for side in (1.0, -1.0))
            M_z = M_z - 0.25 * self.track_width * (inner - outer)
        return wrench._replace(M_z=M_z)
