"""Dead time of the steering: the servo sees the command T seconds late.

In words: your steering answers late.
Formula: δ_ref(t) ← δ_ref(t − T).
Source: transport delay of bus, controller and servo electronics.
In data: measured steering starts to move T after the command, whatever the size of the step.
Excited by: step steers of several sizes, chirps to 5 Hz.
Confused with: steering_second_order (step sizes and chirps tell), steering_sensor_latency (the yaw rate against
    measured steering tells).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from racerl.vehicle.effects import Effect
from racerl.vehicle.ops import Scalar
from racerl.vehicle.parameter import parameter


@dataclass(frozen=True, kw_only=True)
class SteeringDelay(Effect):
    """Dead time between steering command and servo."""

    delay: Scalar = parameter("s", 0.0, 0.2, "T")

    exact: ClassVar[bool] = True

    def delays(self) -> Mapping[str, Scalar]:
        """Return T for the steering reference."""
        return {"delta_ref": self.delay}
