"""Viscous drag: a force in proportion to speed.

In words: your car is held back in proportion to its speed.
Formula: F_x ← F_x − c v_x.
Source: bearing and gear losses.
In data: coast-downs slow exponentially; the wheels run ahead of the car in proportion to speed.
Excited by: coast-downs from several speeds.
Confused with: rolling_resistance, aero_drag, the slip stiffness of the tyres.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from racerl.vehicle.effects import Effect
from racerl.vehicle.ops import Ops, Scalar
from racerl.vehicle.parameter import parameter

if TYPE_CHECKING:
    from racerl.vehicle.vehicle import Forces, Motion, Wrench


@dataclass(frozen=True, kw_only=True)
class ViscousDrag(Effect):
    """Drag that grows with speed."""

    coefficient: Scalar = parameter("N s/m", 0.0, 100.0, "c")

    def wrench(self, wrench: "Wrench", forces: "Forces", motion: "Motion", ops: Ops) -> "Wrench":
        """Subtract c v_x from the longitudinal force."""
        return wrench._replace(F_x=wrench.F_x - self.coefficient * motion.v_x)
