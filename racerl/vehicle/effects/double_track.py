"""Two wheels on each axle, which turn freely of each other, in place of one in the middle.

Formula: the wheels of an axle stand at Y = ±w/2, left and right of its middle. A front wheel points along
    (cos δ − A (Y/L) sin δ, sin δ): with A = 1 both turn about one point in line with the rear axle (Ackermann), with
    A = 0 they are parallel. It moves with (V_x, V_y) in its own frame where one in the middle moves with (V_xm, V_ym),
    so that slips become κ V_m/V and (α* V_m − V_y + V_ym)/V, V of V_x as in the vehicle's equations. Each wheel has
    half of its axle's load and force, which turns with it; M_z ← M_z − (w/4) Σ_axles (F_left − F_right), F along the
    car.
Source: the double-track model with open differentials and without load transfer: geometry.
In data: tight turns, where the inner wheels slip more than the outer ones; power on resists turning.
Excited by: tight turns at low speed, power on and off.
Confused with: nothing that depends on time, place, side or load.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, NamedTuple

from racerl.vehicle.effects import Effect
from racerl.vehicle.ops import Ops, Scalar
from racerl.vehicle.parameter import parameter

if TYPE_CHECKING:
    from racerl.vehicle.vehicle import Forces, Motion, Slips, Wrench


class Side(NamedTuple):
    """What both axles' tyres would do in N at the slips of the wheels of one side."""

    F_xf: Scalar
    F_yf: Scalar
    F_xr: Scalar
    F_yr: Scalar


@dataclass(frozen=True, kw_only=True)
class DoubleTrack(Effect):
    """The mean of the wheels' forces, and their yaw moment, by the tyres' formulas."""

    track_width: Scalar = parameter("m", 0.0, 3.0, "w, distance between left and right wheels", 0.0)
    ackermann: Scalar = parameter("", 0.0, 1.0, "A, share of Ackermann's angle between the front wheels", 1.0)

    physical: ClassVar[bool] = False

    def tyre(self, forces: "Forces", slips: "Slips", motion: "Motion", ops: Ops) -> "Forces":
        """Add by what the mean over an axle's wheels differs from a wheel in its middle."""
        middle = self._tyres(slips, forces, motion, ops)
        left, right = (self._side(side, forces, slips, motion, ops) for side in (1.0, -1.0))
        return forces._replace(
            **{
                name: 0.5 * (one + other) + (getattr(forces, name) - between)
                for name, one, between, other in zip(Side._fields, left, middle, right, strict=True)
            }
        )

    def wrench(self, wrench: "Wrench", forces: "Forces", motion: "Motion", ops: Ops) -> "Wrench":
        """Add the yaw moment of wheels that pull differently."""
        car = motion.car
        slips = car.slips_seen(car.slips(motion, ops), motion, ops)
        left, right = (self._side(side, forces, slips, motion, ops) for side in (1.0, -1.0))
        front = (left.F_xf - right.F_xf) * ops.cos(motion.delta) - (left.F_yf - right.F_yf) * ops.sin(motion.delta)
        return wrench._replace(M_z=wrench.M_z - 0.25 * self.track_width * (front + left.F_xr - right.F_xr))

    def _side(self, side: float, forces: "Forces", slips: "Slips", motion: "Motion", ops: Ops) -> Side:
        """Return the forces of one side's wheels, 1 the left, −1 the right, in the frames of those in the middle."""
        car, Y = motion.car, 0.5 * side * self.track_width
        V_xm, V_ym = car.front_velocity(motion, ops)
        ahead, aside = motion.v_x - Y * motion.yaw_rate, motion.v_y + car.arm * motion.yaw_rate
        cos, sin, turned_cos, turned_sin = self._direction(Y, motion, ops)
        V_m, V_f = car.slip_speed(V_xm, ops), car.slip_speed(ahead * cos + aside * sin, ops)
        rear = car.slip_speed(motion.v_x, ops) / car.slip_speed(ahead, ops)
        alpha_f = (slips.alpha_f * V_m - (aside * cos - ahead * sin) + V_ym) / V_f
        seen = type(slips)(slips.kappa_f * V_m / V_f, alpha_f, slips.kappa_r * rear, slips.alpha_r * rear)
        own = self._tyres(seen, forces, motion, ops)
        along = own.F_xf * turned_cos - own.F_yf * turned_sin
        return own._replace(F_xf=along, F_yf=own.F_xf * turned_sin + own.F_yf * turned_cos)

    def _direction(self, Y: Scalar, motion: "Motion", ops: Ops) -> tuple[Scalar, Scalar, Scalar, Scalar]:
        """Return cosine and sine of the angle of the front wheel at Y, and of how far it is turned from δ."""
        sin, cos = ops.sin(motion.delta), ops.cos(motion.delta)
        share = self.ackermann * Y / motion.car.wheelbase
        ahead = cos - share * sin
        length = ops.sqrt(ahead * ahead + sin * sin)
        return ahead / length, sin / length, (1.0 - share * sin * cos) / length, share * sin * sin / length

    def _tyres(self, slips: "Slips", forces: "Forces", motion: "Motion", ops: Ops) -> Side:
        """Return the forces at given slips, by the tyres' formulas."""
        car, (front, rear) = motion.car, motion.car.grip(motion, ops)
        return Side(
            *car.front.forces(slips.kappa_f, slips.alpha_f, forces.F_zf, front, ops),
            *car.rear.forces(slips.kappa_r, slips.alpha_r, forces.F_zr, rear, ops),
        )
