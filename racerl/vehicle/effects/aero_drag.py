"""Aerodynamic drag: a force in proportion to the square of speed.

In words: the air holds your car back, the more the faster it goes.
Formula: F_x ← F_x − c v_x |v_x|, c = ρ c_d A/2.
Source: drag equation.
In data: coast-downs that slow faster than linearly at speed.
Excited by: coast-downs from top speed.
Confused with: rolling_resistance, viscous_drag when the speed hardly varies.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from racerl.vehicle.effects import Effect
from racerl.vehicle.ops import Ops, Scalar
from racerl.vehicle.parameter import parameter

if TYPE_CHECKING:
    from racerl.vehicle.vehicle import Forces, Motion, Wrench


@dataclass(frozen=True, kw_only=True)
class AeroDrag(Effect):
    """Drag that grows with the square of speed."""

    coefficient: Scalar = parameter("N s²/m²", 0.0, 10.0, "c of c·v²")

    def wrench(self, wrench: "Wrench", forces: "Forces", motion: "Motion", ops: Ops) -> "Wrench":
        """Subtract c v_x |v_x| from the longitudinal force."""
        return wrench._replace(F_x=wrench.F_x - self.coefficient * motion.v_x * ops.abs(motion.v_x))
