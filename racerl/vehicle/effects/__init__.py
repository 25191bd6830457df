"""Physical effects that can be added to the car, one file each, off unless configured.

An effect is a frozen dataclass whose fields are parameters and which overrides only the hooks it needs. Its module
`aero_drag.py` holds the class `AeroDrag`; its YAML is `conf/vehicle/effect/aero_drag.yaml`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from racerl.vehicle.ops import Ops, Scalar

if TYPE_CHECKING:
    from racerl.vehicle.vehicle import Motion, Slips, Wrench


@dataclass(frozen=True, kw_only=True)
class Effect:
    """The hooks, in the order in which the derivative calls them; each returns its input unless overridden."""

    states: ClassVar[tuple[str, ...]] = ()

    def key(self, state: str) -> str:
        """Return the name under which this effect finds one of its own states in `own`."""
        name = type(self).__module__.rsplit(".", 1)[-1]
        return f"{name}.{state}"

    def command(
        self, delta_ref: Scalar, drive_ref: Scalar, own: Mapping[str, Scalar], ops: Ops
    ) -> tuple[Scalar, Scalar]:
        """Change the commands before they reach the actuators."""
        return delta_ref, drive_ref

    def steer(self, delta: Scalar, own: Mapping[str, Scalar], ops: Ops) -> Scalar:
        """Change the road-wheel angle (rad) that the steering angle gives."""
        return delta

    def slip(self, slips: "Slips", motion: "Motion", ops: Ops) -> "Slips":
        """Change the slips that the tyres see."""
        return slips

    def loads(self, F_z: tuple[Scalar, Scalar], motion: "Motion", ops: Ops) -> tuple[Scalar, Scalar]:
        """Change the vertical loads (front, rear) in N."""
        return F_z

    def wrench(self, wrench: "Wrench", motion: "Motion", ops: Ops) -> "Wrench":
        """Change force and moment on the body."""
        return wrench

    def rates(self, steady: "Slips", motion: "Motion", ops: Ops) -> Sequence[Scalar]:
        """Return the derivatives of this effect's own states, given the steady-state slips."""
        return ()
