"""A tyre of another formula: smooth deviations of slips and forces from the Magic Formula's.

Formula: κ e^{−c l} and α* e^{−c l} in place of κ and α*, with l = κ/√(1 + κ + κ²/2), which is near ln(1 + κ) and stays
    between −2 and √2: for c = 1 slips over the wheel's speed instead of the ground's. Then the forces
    F_x (1 + a_1 p + a_2 p² + (a_3 + a_4 p + a_5 q) q) and F_y (1 + b_1 p + b_2 p² + (b_3 + b_4 p + b_5 q) q) with the
    slips σ_x = κ/κ_0, σ_y = α*/α_0, p = σ_x/√(1 + σ_x² + σ_y²) and q = σ_y²/(1 + σ_x² + σ_y²).
Source: a regression over bounded slips, even in the sideways one; the factors stay within ½ of 1 by tanh.
In data: forces that differ between driving and braking, or that no cosine weight gives under combined slip, whatever
    time, place and history.
Excited by: braking and power on in turns.
Confused with: nothing that depends on time, place, side, speed or load.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from racerl.vehicle.effects import Effect
from racerl.vehicle.ops import Ops, Scalar
from racerl.vehicle.parameter import parameter

if TYPE_CHECKING:
    from racerl.vehicle.vehicle import Forces, Motion, Slips

MOST = 0.5  # by which a factor differs from 1


def _weight(meaning: str) -> Scalar:
    value: Scalar = parameter("", -2.0, 2.0, meaning, 0.0)
    return value


@dataclass(frozen=True, kw_only=True)
class TyreShape(Effect):
    """Weights, zero for the Magic Formula, and the slips at which a tyre is half-way to sliding."""

    kappa_f: Scalar = parameter("", 1e-3, 1.0, "κ_0 of the front tyres, slip ratio that counts as large", 0.1)
    alpha_f: Scalar = parameter("", 1e-3, 1.0, "α_0 of the front tyres, slip sideways that counts as large", 0.1)
    kappa_r: Scalar = parameter("", 1e-3, 1.0, "κ_0 of the rear tyres", 0.1)
    alpha_r: Scalar = parameter("", 1e-3, 1.0, "α_0 of the rear tyres", 0.1)
    slip_drive: Scalar = _weight("c: slips when driving, less; when braking, more")
    ahead_drive: Scalar = _weight("a_1: F_x when driving, less when braking")
    ahead_slip: Scalar = _weight("a_2: F_x at slip ahead")
    ahead_turn: Scalar = _weight("a_3: F_x at slip sideways")
    ahead_turn_drive: Scalar = _weight("a_4: F_x at both, when driving")
    ahead_turn_2: Scalar = _weight("a_5: F_x at large slip sideways")
    aside_drive: Scalar = _weight("b_1: F_y when driving, less when braking")
    aside_slip: Scalar = _weight("b_2: F_y at slip ahead")
    aside_turn: Scalar = _weight("b_3: F_y at slip sideways")
    aside_turn_drive: Scalar = _weight("b_4: F_y at both, when driving")
    aside_turn_2: Scalar = _weight("b_5: F_y at large slip sideways")

    physical: ClassVar[bool] = False
    vanishing: ClassVar[int] = 11
    known: ClassVar[tuple[str, ...]] = ("kappa_f", "alpha_f", "kappa_r", "alpha_r")

    def slip(self, slips: "Slips", motion: "Motion", ops: Ops) -> "Slips":
        """Take both axles' slips over another speed."""
        front, rear = (ops.exp(-self.slip_drive * _logarithm(kappa, ops)) for kappa in (slips.kappa_f, slips.kappa_r))
        return type(slips)(slips.kappa_f * front, slips.alpha_f * front, slips.kappa_r * rear, slips.alpha_r * rear)

    def tyre(self, forces: "Forces", slips: "Slips", motion: "Motion", ops: Ops) -> "Forces":
        """Multiply both axles' forces."""
        ahead_f, aside_f = self._factors(slips.kappa_f / self.kappa_f, slips.alpha_f / self.alpha_f, ops)
        ahead_r, aside_r = self._factors(slips.kappa_r / self.kappa_r, slips.alpha_r / self.alpha_r, ops)
        return forces._replace(
            F_xf=forces.F_xf * ahead_f,
            F_yf=forces.F_yf * aside_f,
            F_xr=forces.F_xr * ahead_r,
            F_yr=forces.F_yr * aside_r,
        )

    def _factors(self, x: Scalar, y: Scalar, ops: Ops) -> tuple[Scalar, Scalar]:
        size = ops.sqrt(1.0 + x * x + y * y)
        p, q = x / size, (y / size) * (y / size)
        ahead = self.ahead_drive * p + self.ahead_slip * p * p
        ahead = ahead + (self.ahead_turn + self.ahead_turn_drive * p + self.ahead_turn_2 * q) * q
        aside = self.aside_drive * p + self.aside_slip * p * p
        aside = aside + (self.aside_turn + self.aside_turn_drive * p + self.aside_turn_2 * q) * q
        return 1.0 + MOST * ops.tanh(ahead / MOST), 1.0 + MOST * ops.tanh(aside / MOST)


def _logarithm(kappa: Scalar, ops: Ops) -> Scalar:
    """Return ln(1 + κ) for small κ, bounded and smooth wherever a wheel turns."""
    return kappa / ops.sqrt(1.0 + kappa + 0.5 * kappa * kappa)
