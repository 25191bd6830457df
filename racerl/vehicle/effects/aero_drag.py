"""Aerodynamic drag: F_x = −c v_x |v_x|.

Source: the drag equation with c = ρ c_d A/2. In data: coast-downs that slow faster than linearly at speed.
Excited by coast-downs from top speed; confused with rolling and viscous resistance when the speed hardly varies.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from racerl.vehicle.effects import Effect
from racerl.vehicle.ops import Ops, Scalar
from racerl.vehicle.parameter import parameter

if TYPE_CHECKING:
    from racerl.vehicle.vehicle import Motion, Wrench


@dataclass(frozen=True, kw_only=True)
class AeroDrag(Effect):
    """Drag that grows with the square of speed."""

    coefficient: Scalar = parameter("N s²/m²", 0.0, 10.0, "c of c·v²")

    def wrench(self, wrench: "Wrench", motion: "Motion", ops: Ops) -> "Wrench":
        """Subtract c v_x |v_x| from the longitudinal force."""
        return wrench._replace(F_x=wrench.F_x - self.coefficient * motion.v_x * ops.abs(motion.v_x))
