"""What learned effects share: what they see, bounded forces, limits of what the log showed, the fading beyond them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from racerl.vehicle.effects import Effect
from racerl.vehicle.ops import Ops, Scalar
from racerl.vehicle.parameter import parameter

if TYPE_CHECKING:
    from racerl.vehicle.vehicle import Motion, Wrench

MOST_FORCE, MOST_MOMENT = 3.0, 30.0  # m/s² and rad/s²
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

    def push(self, wrench: "Wrench", motion: "Motion", learned: Sequence[Scalar], ops: Ops) -> "Wrench":
        """Add what was learned of F_x/m, F_y/m and M_z/(10 J), bounded, where the log has been."""
        ahead, aside, about = learned
        share = self.inside(motion, ops)
        force, moment = share * motion.car.mass * MOST_FORCE, share * motion.car.yaw_inertia * MOST_MOMENT
        return wrench._replace(
            F_x=wrench.F_x + force * ops.tanh(ahead / MOST_FORCE),
            F_y=wrench.F_y + force * ops.tanh(aside / MOST_FORCE),
            M_z=wrench.M_z + moment * ops.tanh(10.0 * about / MOST_MOMENT),
        )


def scaled(motion: "Motion", ops: Ops) -> tuple[Scalar, ...]:
    """Return speed, steering, yaw rate, sideways speed and slip ratio, each inside ± 1."""
    slip = 10.0 * (motion.omega - motion.v_x) / motion.car.slip_speed(motion.v_x, ops)
    seen = (motion.v_x / 3.0, motion.delta / 0.2, motion.yaw_rate / 3.0, motion.v_y / 0.5, slip)
    return tuple(map(ops.tanh, seen))
