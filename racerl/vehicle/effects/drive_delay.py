"""Dead time of the drive: the motor controller sees the command T seconds late.

In words: your drive answers late.
Formula: u(t) ← u(t − T) for the wheel-speed or current reference.
Source: transport delay of bus and motor controller.
In data: measured wheel speed starts to move T after the command.
Excited by: speed steps up and down.
Confused with: wheel_speed_latency (the car's own acceleration against wheel speed tells), a longer time constant.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from racerl.vehicle.effects import Effect
from racerl.vehicle.ops import Scalar
from racerl.vehicle.parameter import parameter


@dataclass(frozen=True, kw_only=True)
class DriveDelay(Effect):
    """Dead time between drive command and motor."""

    delay: Scalar = parameter("s", 0.0, 0.2, "T")

    exact: ClassVar[bool] = True

    def delays(self) -> Mapping[str, Scalar]:
        """Return T for the drive's reference."""
        return {"drive_ref": self.delay}
