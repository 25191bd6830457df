"""The measured wheel speed is late.

In words: your wheel speed sensor is late.
Formula: logged(t) = true(t − T) for omega.
Source: filters, exposure and transport of the measurement.
In data: the car speeds up before the measured wheel speed does.
Excited by: speed steps.
Confused with: drive_delay (the car speeds up when the wheels do).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from racerl.vehicle.effects import Effect
from racerl.vehicle.ops import Scalar
from racerl.vehicle.parameter import parameter


@dataclass(frozen=True, kw_only=True)
class WheelSpeedLatency(Effect):
    """Latency of the wheel speed."""

    latency: Scalar = parameter("s", 0.0, 0.2, "T")

    exact: ClassVar[bool] = True

    def latencies(self) -> Mapping[str, Scalar]:
        """Return T for what is late."""
        return {"omega": self.latency}
