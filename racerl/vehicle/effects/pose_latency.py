"""Motion capture is late against what is measured on board.

In words: the motion capture is late.
Formula: logged(t) = true(t − T) for x, y, yaw, v_x, v_y, yaw_rate.
Source: filters, exposure and transport of the measurement.
In data: yaw rate and speed follow measured steering and wheel speed later than the car can be.
Excited by: step steers, speed steps.
Confused with: command_timestamp_offset (of the other sign), tyre_relaxation (shrinks with speed).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from racerl.vehicle.effects import Effect
from racerl.vehicle.ops import Scalar
from racerl.vehicle.parameter import parameter


@dataclass(frozen=True, kw_only=True)
class PoseLatency(Effect):
    """Latency of pose and velocities."""

    latency: Scalar = parameter("s", 0.0, 0.2, "T")

    exact: ClassVar[bool] = True

    def latencies(self) -> Mapping[str, Scalar]:
        """Return T for what is late."""
        return dict.fromkeys(("x", "y", "yaw", "v_x", "v_y", "yaw_rate"), self.latency)
