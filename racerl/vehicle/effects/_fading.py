"""What learned effects share: limits of what the log showed, and the fading beyond them."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from racerl.vehicle.effects import Effect
from racerl.vehicle.ops import Ops, Scalar
from racerl.vehicle.parameter import parameter

if TYPE_CHECKING:
    from racerl.vehicle.vehicle import Motion

STEEPNESS = 8.0  # of the fading beyond 1.2 times the log's greatest values


@dataclass(frozen=True, kw_only=True)
class Fading(Effect):
    """A learned effect: off where the log has not been, of no physical name, and on no side's favour by itself."""

    speed: Scalar = parameter("m/s", 0.1, 100.0, "greatest speed seen", 5.0)
    steering: Scalar = parameter("rad", 0.01, 1.5, "greatest steering angle seen", 0.5)
    yaw_rate: Scalar = parameter("rad/s", 0.1, 50.0, "greatest yaw rate seen", 8.0)

    symmetric: ClassVar[bool] = False
    physical: ClassVar[bool] = False
    known: ClassVar[tuple[str, ...]] = ("speed", "steering", "yaw_rate")

    def inside(self, motion: "Motion", ops: Ops) -> Scalar:
        """Return 1 where the log has been, falling to 0 beyond."""
        share: Scalar = 1.0
        for value, most in ((motion.v_x, self.speed), (motion.delta, self.steering), (motion.yaw_rate, self.yaw_rate)):
            beyond = ops.abs(value) / most - 1.2
            share = share * 0.5 * (1.0 - ops.tanh(STEEPNESS * beyond))
        return share
