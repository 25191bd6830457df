"""Left and right wheels turn at one speed and drag against each other in turns.

Formula: M_z = −k r/V, V = √(v_x² + v_0²), v_0 = 0.5 m/s: with track width w, k = C_κ w²/2.
Source: Milliken and Milliken 1995, chapter 20: the yaw moment of a spool.
In data: turns are wider at low speed than the tyres foretell, less so at high speed.
Excited by: equal yaw rates at two speeds, power on and off.
Confused with: yaw_damping (not with 1/V), steering_gain.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from racerl.vehicle.effects import Effect
from racerl.vehicle.ops import Ops, Scalar
from racerl.vehicle.parameter import parameter

if TYPE_CHECKING:
    from racerl.vehicle.vehicle import Forces, Motion, Wrench

SLOW = 0.5  # m/s


@dataclass(frozen=True, kw_only=True)
class LockedDifferential(Effect):
    """Yaw moment against the turn, in proportion to curvature."""

    stiffness: Scalar = parameter("N m²", 0.0, 20.0, "k, in N m per rad/m of path")

    def wrench(self, wrench: "Wrench", forces: "Forces", motion: "Motion", ops: Ops) -> "Wrench":
        """Subtract k r/V from the yaw moment."""
        pace = ops.sqrt(motion.v_x * motion.v_x + SLOW * SLOW)
        return wrench._replace(M_z=wrench.M_z - self.stiffness * motion.yaw_rate / pace)
