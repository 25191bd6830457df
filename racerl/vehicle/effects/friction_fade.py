"""Grip is lost over time.

In words: your tyres lose grip over time.
Formula: μ ← μ (1 − k τ (1 − exp(−t/τ))), not below a tenth.
Source: wear and dust; a line at first, which levels off.
In data: the same manoeuvre shows less grip late than early, a rest does not bring it back.
Excited by: the same manoeuvres early and late.
Confused with: tyre_heating (a rest brings grip back), friction_patch (the same place tells), battery_sag (speed, not
    grip).
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from racerl.vehicle.effects import Pair, scaled
from racerl.vehicle.effects._ageing import Ageing
from racerl.vehicle.ops import Ops, Scalar
from racerl.vehicle.parameter import parameter

if TYPE_CHECKING:
    from racerl.vehicle.vehicle import Motion


@dataclass(frozen=True, kw_only=True)
class FrictionFade(Ageing):
    """Loss of grip over time."""

    rate: Scalar = parameter("1/s", -0.01, 0.01, "k, positive for a loss")
    time: Scalar = parameter("s", 10.0, 100000.0, "τ over which the loss levels off")

    def grip(self, friction: Pair, motion: "Motion", ops: Ops) -> Pair:
        """Scale the grip by 1 − k τ (1 − exp(−t/τ))."""
        return scaled(friction, 1.0 - self.rate * self.age(motion.own, self.time, ops), ops)
