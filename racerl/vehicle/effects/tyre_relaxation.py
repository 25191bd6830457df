"""Tyre relaxation: the slip angle builds up over a distance σ, α̇ = (V/σ)(α_ss − α).

Source: Pacejka 2012, chapter 7 (single-contact-point transient model). In data: lateral force and yaw rate lag the
steering by a time that shrinks with speed. Excited by step steers at several speeds; confused with steering delay when
the speed hardly varies.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from racerl.vehicle.effects import Effect
from racerl.vehicle.ops import Ops, Scalar
from racerl.vehicle.parameter import parameter

if TYPE_CHECKING:
    from racerl.vehicle.vehicle import Motion, Slips


@dataclass(frozen=True, kw_only=True)
class TyreRelaxation(Effect):
    """First-order lag of α* in both axles, over distance."""

    length: Scalar = parameter("m", 0.005, 1.0, "relaxation length σ")
    states: ClassVar[tuple[str, ...]] = ("alpha_f", "alpha_r")

    def slip(self, slips: "Slips", motion: "Motion", ops: Ops) -> "Slips":
        """Let the tyres see the lagging slip angles."""
        return slips._replace(alpha_f=motion.own[self.key("alpha_f")], alpha_r=motion.own[self.key("alpha_r")])

    def rates(self, steady: "Slips", motion: "Motion", ops: Ops) -> Sequence[Scalar]:
        """Return (|v_x| + 0.1)/σ · (α_ss − α); the 0.1 m/s lets the slip settle at standstill."""
        pace = (ops.abs(motion.v_x) + 0.1) / self.length
        return (
            pace * (steady.alpha_f - motion.own[self.key("alpha_f")]),
            pace * (steady.alpha_r - motion.own[self.key("alpha_r")]),
        )
