"""The wheel speed sensor is off by a factor.

In words: your wheel speed sensor is off by a factor.
Formula: logged ω = k · true ω.
Source: wrong wheel radius or gear ratio.
In data: measured wheel speed and the car's speed differ by one factor on straights, and from the command too.
Excited by: steady speeds on straights.
Confused with: wheel_growth (grows with speed), viscous_drag (needs force).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from racerl.vehicle.effects import Effect
from racerl.vehicle.ops import Scalar
from racerl.vehicle.parameter import parameter


@dataclass(frozen=True, kw_only=True)
class WheelSpeedGain(Effect):
    """Gain of the measured wheel speed."""

    gain: Scalar = parameter("", 0.5, 1.5, "k")

    exact: ClassVar[bool] = True

    def measure(self, channels: Mapping[str, Scalar], ops: Any) -> Mapping[str, Scalar]:
        """Return k ω."""
        return {"omega": self.gain * channels["omega"]}
