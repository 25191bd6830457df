"""The speed reached falls short of the command, more and more as the battery runs down.

Formula: ω_ref ← ω_ref (1 − k t).
Source: discharge line of a lithium battery.
In data: steady wheel speeds fall short of their commands, later more than earlier.
Excited by: the same speeds early and late.
Confused with: wheel_speed_gain (not over time), drive_load_droop (with force).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from racerl.vehicle.effects import Effect
from racerl.vehicle.ops import Ops, Scalar
from racerl.vehicle.parameter import parameter

if TYPE_CHECKING:
    from racerl.vehicle.vehicle import Course


@dataclass(frozen=True, kw_only=True)
class BatterySag(Effect):
    """Loss of speed over time."""

    rate: Scalar = parameter("1/s", 0.0, 0.01, "k")

    states: ClassVar[tuple[str, ...]] = ("clock",)
    told: ClassVar[tuple[str, ...]] = states
    uniform: ClassVar[bool] = False

    def command(
        self, delta_ref: Scalar, drive_ref: Scalar, own: Mapping[str, Scalar], ops: Ops
    ) -> tuple[Scalar, Scalar]:
        """Scale the drive's reference by 1 − k t."""
        return delta_ref, drive_ref * (1.0 - self.rate * own[self.key("clock")])

    def rates(self, course: "Course", ops: Ops) -> Sequence[Scalar]:
        """Return the rate of time."""
        return (1.0 + 0.0 * course.motion.v_x,)
