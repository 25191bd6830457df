"""The measured steering angle is late.

In words: your steering sensor is late.
Formula: logged(t) = true(t − T) for delta.
Source: filters, exposure and transport of the measurement.
In data: the car turns before the measured steering angle does; the command leads it by the same time too much.
Excited by: step steers, chirps.
Confused with: steering_delay (the car turns when the angle does).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from racerl.vehicle.effects import Effect
from racerl.vehicle.ops import Scalar
from racerl.vehicle.parameter import parameter


@dataclass(frozen=True, kw_only=True)
class SteeringSensorLatency(Effect):
    """Latency of the steering angle."""

    latency: Scalar = parameter("s", 0.0, 0.2, "T")

    exact: ClassVar[bool] = True

    def latencies(self) -> Mapping[str, Scalar]:
        """Return T for what is late."""
        return {"delta": self.latency}
