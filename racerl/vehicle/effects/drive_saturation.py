"""The wheels turn no faster than ω_max, whatever is commanded.

In words: your wheels turn no faster than a limit, whatever is commanded.
Formula: |ω_ref| ≤ ω_max, with a rounded corner.
Source: speed limit of the motor controller.
In data: commands beyond ω_max all end at one measured wheel speed.
Excited by: speed steps up to the fastest command.
Confused with: wheel_speed_gain (slow commands, too), back_emf (it only slows the way there), battery_sag (over time).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from racerl.vehicle.effects import Effect
from racerl.vehicle.ops import Ops, Scalar, soft_clip
from racerl.vehicle.parameter import parameter


@dataclass(frozen=True, kw_only=True)
class DriveSaturation(Effect):
    """Largest wheel speed."""

    unbounded: ClassVar[tuple[str, ...]] = ("limit",)
    of_speed: ClassVar[bool] = True
    limit: Scalar = parameter("m/s", 0.1, 100.0, "ω_max")

    def command(
        self, delta_ref: Scalar, drive_ref: Scalar, own: Mapping[str, Scalar], ops: Ops
    ) -> tuple[Scalar, Scalar]:
        """Keep the drive's reference within ± ω_max."""
        return delta_ref, soft_clip(drive_ref, self.limit, ops)
