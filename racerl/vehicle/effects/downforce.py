"""Aerodynamic downforce: F_z grows by c v², split over the axles by `balance`.

Source: the lift equation with c = −ρ c_l A/2. In data: more lateral acceleration at speed than at the same slip when
slow. Excited by equal radii at two speeds; confused with friction that depends on speed.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from racerl.vehicle.effects import Effect
from racerl.vehicle.ops import Ops, Scalar
from racerl.vehicle.parameter import parameter

if TYPE_CHECKING:
    from racerl.vehicle.vehicle import Motion


@dataclass(frozen=True, kw_only=True)
class Downforce(Effect):
    """Vertical load that grows with the square of speed."""

    coefficient: Scalar = parameter("N s²/m²", 0.0, 10.0, "c of c·v²")
    balance: Scalar = parameter("", 0.0, 1.0, "share of the front axle", 0.5)

    def loads(self, F_z: tuple[Scalar, Scalar], motion: "Motion", ops: Ops) -> tuple[Scalar, Scalar]:
        """Add c v² to the loads."""
        force = self.coefficient * motion.v_x * motion.v_x
        return F_z[0] + self.balance * force, F_z[1] + (1.0 - self.balance) * force
