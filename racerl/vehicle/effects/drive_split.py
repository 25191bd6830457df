"""A differential between the axles shares the drive's force, whatever their slips ask for.

Formula: F_xf ← q F and F_xr ← (1 − q) F with F = F_xf + F_xr.
Source: Milliken and Milliken 1995, chapter 20: centre differentials; q = ½ for an even one, 0 or 1 for one driven axle.
In data: power on in a turn pulls the nose in (large q) or pushes it out.
Excited by: power on in turns, braking in turns.
Confused with: cog_lateral_offset, locked_differential.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from racerl.vehicle.effects import Effect
from racerl.vehicle.ops import Ops, Scalar
from racerl.vehicle.parameter import parameter

if TYPE_CHECKING:
    from racerl.vehicle.vehicle import Forces, Motion, Wrench


@dataclass(frozen=True, kw_only=True)
class DriveSplit(Effect):
    """Share of the front axle in the drive's force."""

    front: Scalar = parameter("", 0.0, 1.0, "q", 0.5)

    def wrench(self, wrench: "Wrench", forces: "Forces", motion: "Motion", ops: Ops) -> "Wrench":
        """Move a part of the drive from axle to axle."""
        moved = self.front * (forces.F_xf + forces.F_xr) - forces.F_xf
        aside = moved * ops.sin(motion.delta)
        return wrench._replace(
            F_x=wrench.F_x + moved * (ops.cos(motion.delta) - 1.0),
            F_y=wrench.F_y + aside,
            M_z=wrench.M_z + motion.car.arm * aside,
        )
