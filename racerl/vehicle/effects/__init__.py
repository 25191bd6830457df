"""Physical effects that can be added to the car, one file each, off unless configured.

An effect is a frozen dataclass whose fields are parameters and which overrides only the hooks it needs. Its module
`aero_drag.py` holds the class `AeroDrag`; its YAML is `conf/vehicle/effect/aero_drag.yaml`. The module's docstring says
what the effect is: `Formula`, `Source`, `In data`, `Excited by`, `Confused with`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from racerl.vehicle.ops import Ops, Scalar

if TYPE_CHECKING:
    from racerl.vehicle.vehicle import Course, Forces, Motion, Slips, Wrench

Pair = tuple[Scalar, Scalar]
"""One value for the front axle, one for the rear."""

SMOOTH_SPEED = 0.1  # m/s over which a force changes its sign with the motion
LEAST_GRIP = 0.1  # share of the friction that no loss takes away


def scaled(friction: Pair, left: Scalar, ops: Ops) -> Pair:
    """Return the friction scales of both axles of which a share is left."""
    left = ops.maximum(left, LEAST_GRIP)
    return friction[0] * left, friction[1] * left


@dataclass(frozen=True, kw_only=True)
class Effect:
    """The hooks, in the order in which the car calls them; each returns its input unless overridden."""

    states: ClassVar[tuple[str, ...]] = ()
    symmetric: ClassVar[bool] = True  # a mirrored drive stays possible
    uniform: ClassVar[bool] = True  # the same everywhere, in every direction and at all times
    physical: ClassVar[bool] = True  # of the catalogue
    exact: ClassVar[bool] = False  # it has one form: a shift in time or place, a rotation, an offset, a gain
    vanishing: ClassVar[int] = 1  # of its unknowns, the first ones, that are 0, or 1 for a factor, without the effect
    unbounded: ClassVar[tuple[str, ...]] = ()  # or limits, all of which are infinite without it
    of_speed: ClassVar[bool] = False  # it acts on a commanded wheel speed; a commanded current is none
    known: ClassVar[tuple[str, ...]] = ()  # parameters that no fit changes
    memory: ClassVar[tuple[str, ...]] = ()  # time constants of own states that are first-order lags over seconds
    told: ClassVar[tuple[str, ...]] = ()  # own states that the drive so far tells, whatever a window of a second shows

    def key(self, state: str) -> str:
        """Return the name under which this effect finds one of its own states in `own`."""
        name = type(self).__module__.rsplit(".", 1)[-1]
        return f"{name}.{state}"

    def arm(self, l_f: Scalar) -> Scalar:
        """Change the distance of the centre of gravity from the front axle in m."""
        return l_f

    def delays(self) -> Mapping[str, Scalar]:
        """Return by how many seconds `delta_ref` or `drive_ref` act late."""
        return {}

    def command(
        self, delta_ref: Scalar, drive_ref: Scalar, own: Mapping[str, Scalar], ops: Ops
    ) -> tuple[Scalar, Scalar]:
        """Change the commands before they reach the actuators."""
        return delta_ref, drive_ref

    def link(self, delta: Scalar, own: Mapping[str, Scalar], ops: Ops) -> Scalar:
        """Return the angle that the servo passes on to the linkage."""
        return delta

    def steer(self, delta: Scalar, own: Mapping[str, Scalar], ops: Ops) -> Scalar:
        """Change the road-wheel angle (rad) that the steering angle gives."""
        return delta

    def slip(self, slips: "Slips", motion: "Motion", ops: Ops) -> "Slips":
        """Change the slips that the tyres see."""
        return slips

    def grip(self, friction: Pair, motion: "Motion", ops: Ops) -> Pair:
        """Change the friction scales of both axles."""
        return friction

    def loads(self, F_z: Pair, motion: "Motion", ops: Ops) -> Pair:
        """Change the vertical loads in N."""
        return F_z

    def tyre(self, forces: "Forces", slips: "Slips", motion: "Motion", ops: Ops) -> "Forces":
        """Change what the tyres do at given slips."""
        return forces

    def wrench(self, wrench: "Wrench", forces: "Forces", motion: "Motion", ops: Ops) -> "Wrench":
        """Change force and moment on the body."""
        return wrench

    def steering_rate(self, rate: Scalar, course: "Course", ops: Ops) -> Scalar:
        """Change δ̇ in rad/s."""
        return rate

    def drive_rate(self, rate: Scalar, course: "Course", ops: Ops) -> Scalar:
        """Change ω̇ in m/s²."""
        return rate

    def rates(self, course: "Course", ops: Ops) -> Sequence[Scalar]:
        """Return the derivatives of this effect's own states."""
        return ()

    def measure(self, channels: Mapping[str, Scalar], ops: Any) -> Mapping[str, Scalar]:
        """Return the channels that sensors show otherwise than `channels` (rows of the state by name) says."""
        return {}

    def latencies(self) -> Mapping[str, Scalar]:
        """Return by how many seconds channels of a log are late."""
        return {}
