"""Aerodynamic downforce: the vertical load grows with the square of speed.

In words: the air presses your car down, the more the faster it goes.
Formula: F_z ← F_z + c v_x², shared over the axles by `balance`; c = −ρ c_l A/2.
Source: lift equation.
In data: more lateral acceleration at speed than at the same slip when slow.
Excited by: equal radii at two speeds.
Confused with: speed_dependent_friction (of the other sign), lateral_load_sensitivity.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from racerl.vehicle.effects import Effect, Pair
from racerl.vehicle.ops import Ops, Scalar
from racerl.vehicle.parameter import parameter

if TYPE_CHECKING:
    from racerl.vehicle.vehicle import Motion


@dataclass(frozen=True, kw_only=True)
class Downforce(Effect):
    """Vertical load that grows with the square of speed."""

    coefficient: Scalar = parameter("N s²/m²", 0.0, 10.0, "c of c·v²")
    balance: Scalar = parameter("", 0.0, 1.0, "share of the front axle", 0.5)

    def loads(self, F_z: Pair, motion: "Motion", ops: Ops) -> Pair:
        """Add c v² to the loads."""
        force = self.coefficient * motion.v_x * motion.v_x
        return F_z[0] + self.balance * force, F_z[1] + (1.0 - self.balance) * force
