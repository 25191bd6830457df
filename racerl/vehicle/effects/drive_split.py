"""The drive is not shared equally by the axles.

Formula: κ_f ← 2 q κ_f, κ_r ← 2 (1 − q) κ_r.
Source: centre differential or a one-axle drive: the axle without torque rolls freely.
In data: power on in a turn pushes the nose out (q > ½) or the tail.
Excited by: power on in turns, braking in turns.
Confused with: cog_lateral_offset, locked_differential.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from racerl.vehicle.effects import Effect
from racerl.vehicle.ops import Ops, Scalar
from racerl.vehicle.parameter import parameter

if TYPE_CHECKING:
    from racerl.vehicle.vehicle import Motion, Slips


@dataclass(frozen=True, kw_only=True)
class DriveSplit(Effect):
    """Share of the front axle in the slip of the drive."""

    front: Scalar = parameter("", 0.0, 1.0, "q", 0.5)

    def slip(self, slips: "Slips", motion: "Motion", ops: Ops) -> "Slips":
        """Share out the slip ratio."""
        share = 2.0 * self.front
        return slips._replace(kappa_f=share * slips.kappa_f, kappa_r=(2.0 - share) * slips.kappa_r)
