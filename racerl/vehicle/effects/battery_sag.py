"""The speed reached falls short of the command, more and more as the battery runs down.

In words: your car gets slower as the battery runs down.
Formula: ω_ref ← ω_ref (1 − k τ (1 − exp(−t/τ))).
Source: discharge curve of a lithium battery: steep at first, then flatter.
In data: steady wheel speeds fall short of their commands, later more than earlier.
Excited by: the same speeds early and late.
Confused with: wheel_speed_gain (not over time), drive_load_droop (with force).
"""

from collections.abc import Mapping
from dataclasses import dataclass

from racerl.vehicle.effects._ageing import Ageing
from racerl.vehicle.ops import Ops, Scalar
from racerl.vehicle.parameter import parameter


@dataclass(frozen=True, kw_only=True)
class BatterySag(Ageing):
    """Loss of speed over time."""

    rate: Scalar = parameter("1/s", 0.0, 0.01, "k")
    time: Scalar = parameter("s", 10.0, 100000.0, "τ over which the loss levels off")

    def command(
        self, delta_ref: Scalar, drive_ref: Scalar, own: Mapping[str, Scalar], ops: Ops
    ) -> tuple[Scalar, Scalar]:
        """Scale the drive's reference by 1 − k τ (1 − exp(−t/τ))."""
        return delta_ref, drive_ref * (1.0 - self.rate * self.age(own, self.time, ops))
