"""The road wheels stop at ± δ_max.

In words: your road wheels stop short of the lock.
Formula: |δ_w| ≤ δ_max, with a rounded corner.
Source: mechanical stop of the steering.
In data: beyond δ_max more steering changes nothing.
Excited by: a ramp to full lock.
Confused with: steering_nonlinearity.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from racerl.vehicle.effects import Effect
from racerl.vehicle.ops import Ops, Scalar, soft_clip
from racerl.vehicle.parameter import parameter


@dataclass(frozen=True, kw_only=True)
class SteeringSaturation(Effect):
    """Largest road-wheel angle."""

    limit: Scalar = parameter("rad", 0.05, 1.0, "δ_max")

    unbounded: ClassVar[tuple[str, ...]] = ("limit",)

    def steer(self, delta: Scalar, own: Mapping[str, Scalar], ops: Ops) -> Scalar:
        """Return δ within ± δ_max."""
        return soft_clip(delta, self.limit, ops)
