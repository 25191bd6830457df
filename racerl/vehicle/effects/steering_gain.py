"""The road wheels turn by k times the measured angle.

In words: your road wheels turn by another factor than the steering says.
Formula: δ_w = k δ.
Source: calibration of the steering sensor or of the servo.
In data: every circle is tighter or wider by one factor, at low speed too.
Excited by: circles at low speed.
Confused with: steering_nonlinearity (large angles), wheel_speed_gain (all speeds).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from racerl.vehicle.effects import Effect
from racerl.vehicle.ops import Ops, Scalar
from racerl.vehicle.parameter import parameter


@dataclass(frozen=True, kw_only=True)
class SteeringGain(Effect):
    """Gain between steering angle and road wheels."""

    gain: Scalar = parameter("", 0.5, 1.5, "k")

    exact: ClassVar[bool] = True

    def steer(self, delta: Scalar, own: Mapping[str, Scalar], ops: Ops) -> Scalar:
        """Return k δ."""
        return self.gain * delta
