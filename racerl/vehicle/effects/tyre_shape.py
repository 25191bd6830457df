"""A tyre of another formula: smooth deviations of its forces from the Magic Formula, alike on both axles.

Formula: F_x (1 + a_1 p + a_2 p² + (a_3 + a_4 p + a_5 q) q), F_y (1 + b_1 p + b_2 p² + (b_3 + b_4 p + b_5 q) q) with the
    slips σ_x = κ/κ_0, σ_y = α*/α_0, p = σ_x/√(1 + σ_x² + σ_y²) and q = σ_y²/(1 + σ_x² + σ_y²).
Source: a regression over bounded slips, even in the sideways one; the factors stay within ½ of 1 by tanh.
In data: forces under combined slip that no cosine weight gives, whatever time, place and history.
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

    kappa: Scalar = parameter("", 1e-3, 1.0, "κ_0, slip ratio that counts as large", 0.1)
    alpha: Scalar = parameter("", 1e-3, 1.0, "α_0, slip sideways that counts as large", 0.1)
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
    known: ClassVar[tuple[str, ...]] = ("kappa", "alpha")

    def tyre(self, forces: "Forces", slips: "Slips", motion: "Motion", ops: Ops) -> "Forces":
        """Multiply both axles' forces."""
        ahead_f, aside_f = self._factors(slips.kappa_f, slips.alpha_f, ops)
        ahead_r, aside_r = self._factors(slips.kappa_r, slips.alpha_r, ops)
        return forces._replace(
            F_xf=forces.F_xf * ahead_f,
            F_yf=forces.F_yf * aside_f,
            F_xr=forces.F_xr * ahead_r,
            F_yr=forces.F_yr * aside_r,
        )

    def _factors(self, kappa: Scalar, alpha: Scalar, ops: Ops) -> tuple[Scalar, Scalar]:
        x, y = kappa / self.kappa, alpha / self.alpha
        size = ops.sqrt(1.0 + x * x + y * y)
        p, q = x / size, (y / size) * (y / size)
        ahead = self.ahead_drive * p + self.ahead_slip * p * p
        ahead = ahead + (self.ahead_turn + self.ahead_turn_drive * p + self.ahead_turn_2 * q) * q
        aside = self.aside_drive * p + self.aside_slip * p * p
        aside = aside + (self.aside_turn + self.aside_turn_drive * p + self.aside_turn_2 * q) * q
        return 1.0 + MOST * ops.tanh(ahead / MOST), 1.0 + MOST * ops.tanh(aside / MOST)
