"""A moment against the yaw rate.

In words: your car resists turning.
Formula: M_z ← M_z − c r.
Source: tyre scrub and air, in proportion to the yaw rate.
In data: turns are wider than the tyres foretell, by the same moment at equal yaw rate at any speed.
Excited by: equal yaw rates at two speeds.
Confused with: locked_differential (falls with speed), more yaw inertia (transients only).
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from racerl.vehicle.effects import Effect
from racerl.vehicle.ops import Ops, Scalar
from racerl.vehicle.parameter import parameter

if TYPE_CHECKING:
    from racerl.vehicle.vehicle import Forces, Motion, Wrench


@dataclass(frozen=True, kw_only=True)
class YawDamping(Effect):
    """Moment in proportion to the yaw rate."""

    coefficient: Scalar = parameter("N m s", 0.0, 5.0, "c")

    def wrench(self, wrench: "Wrench", forces: "Forces", motion: "Motion", ops: Ops) -> "Wrench":
        """Subtract c r from the yaw moment."""
        return wrench._replace(M_z=wrench.M_z - self.coefficient * motion.yaw_rate)
