"""Commands and on-board measurements carry stamps that are off against motion capture.

In words: your car's clock and the motion capture's are apart.
Formula: logged(t) = true(t − T) for delta_ref, omega_ref, delta, omega.
Source: filters, exposure and transport of the measurement.
In data: all on-board channels lead or lag the car's motion by one time, and agree among themselves.
Excited by: step steers, speed steps.
Confused with: pose_latency (on-board channels seem early by the same time), two separate latencies.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from racerl.vehicle.effects import Effect
from racerl.vehicle.ops import Scalar
from racerl.vehicle.parameter import parameter


@dataclass(frozen=True, kw_only=True)
class CommandTimestampOffset(Effect):
    """One shift of all on-board channels."""

    latency: Scalar = parameter("s", -0.2, 0.2, "T, positive if on-board channels are late")

    exact: ClassVar[bool] = True

    def latencies(self) -> Mapping[str, Scalar]:
        """Return T for what is late."""
        return dict.fromkeys(("delta_ref", "omega_ref", "delta", "omega"), self.latency)
