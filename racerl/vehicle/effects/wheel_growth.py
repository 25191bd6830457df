"""Tyres grow with speed, so that the wheel speed sensor shows too little.

In words: your tyres grow with speed.
Formula: logged ω = true ω (1 − c ω²).
Source: centrifugal growth of soft tyres.
In data: the car outruns its measured wheel speed more and more with speed.
Excited by: steady speeds from slow to fast on straights.
Confused with: wheel_speed_gain (the same at every speed), aero_drag (needs force).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from racerl.vehicle.effects import Effect
from racerl.vehicle.ops import Scalar
from racerl.vehicle.parameter import parameter


@dataclass(frozen=True, kw_only=True)
class WheelGrowth(Effect):
    """Loss of the measured wheel speed with its square."""

    coefficient: Scalar = parameter("s²/m²", 0.0, 0.02, "c")

    def measure(self, channels: Mapping[str, Scalar], ops: Any) -> Mapping[str, Scalar]:
        """Return ω (1 − c ω²)."""
        omega = channels["omega"]
        return {"omega": omega * (1.0 - self.coefficient * omega * omega)}
