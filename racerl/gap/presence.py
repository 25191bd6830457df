"""All effects in one vehicle, each with a presence of 0 or 1, so that one kernel serves every set of them.

A hook's outcome is base + p (outcome − base). Own states of absent effects go on, unheard. Effects that only shift
channels in time are left out: stages treat shifts themselves.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from racerl.vehicle.effects import Effect, Pair
from racerl.vehicle.ops import Ops, Scalar
from racerl.vehicle.parameter import parameter
from racerl.vehicle.vehicle import Vehicle

if TYPE_CHECKING:
    from racerl.vehicle.vehicle import Course, Forces, Motion, Slips, Wrench


@dataclass(frozen=True, kw_only=True)
class Present(Effect):
    """An effect, there or not."""

    effect: Effect
    presence: Scalar = parameter("", 0.0, 1.0, "1 if the effect is there, 0 if not", 1.0)

    @property
    def states(self) -> tuple[str, ...]:  # type: ignore[override]
        """Names of the effect's own states."""
        return self.effect.states

    def _mix(self, base: Scalar, outcome: Scalar) -> Scalar:
        return base + self.presence * (outcome - base)

    def _mix_all(self, base: Sequence[Scalar], outcome: Sequence[Scalar]) -> list[Scalar]:
        # what the effect leaves alone stays the same expression
        return [b if o is b else self._mix(b, o) for b, o in zip(base, outcome, strict=True)]

    def arm(self, l_f: Scalar) -> Scalar:  # noqa: D102
        return self._mix_all([l_f], [self.effect.arm(l_f)])[0]

    def command(  # noqa: D102
        self, delta_ref: Scalar, drive_ref: Scalar, own: Mapping[str, Scalar], ops: Ops
    ) -> tuple[Scalar, Scalar]:
        steering, drive = self._mix_all((delta_ref, drive_ref), self.effect.command(delta_ref, drive_ref, own, ops))
        return steering, drive

    def link(self, delta: Scalar, own: Mapping[str, Scalar], ops: Ops) -> Scalar:  # noqa: D102
        return self._mix_all([delta], [self.effect.link(delta, own, ops)])[0]

    def steer(self, delta: Scalar, own: Mapping[str, Scalar], ops: Ops) -> Scalar:  # noqa: D102
        return self._mix_all([delta], [self.effect.steer(delta, own, ops)])[0]

    def slip(self, slips: "Slips", motion: "Motion", ops: Ops) -> "Slips":  # noqa: D102
        return type(slips)(*self._mix_all(slips, self.effect.slip(slips, motion, ops)))

    def grip(self, friction: Pair, motion: "Motion", ops: Ops) -> Pair:  # noqa: D102
        front, rear = self._mix_all(friction, self.effect.grip(friction, motion, ops))
        return front, rear

    def loads(self, F_z: Pair, motion: "Motion", ops: Ops) -> Pair:  # noqa: D102
        front, rear = self._mix_all(F_z, self.effect.loads(F_z, motion, ops))
        return front, rear

    def tyre(self, forces: "Forces", slips: "Slips", motion: "Motion", ops: Ops) -> "Forces":  # noqa: D102
        return type(forces)(*self._mix_all(forces, self.effect.tyre(forces, slips, motion, ops)))

    def wrench(self, wrench: "Wrench", forces: "Forces", motion: "Motion", ops: Ops) -> "Wrench":  # noqa: D102
        return type(wrench)(*self._mix_all(wrench, self.effect.wrench(wrench, forces, motion, ops)))

    def steering_rate(self, rate: Scalar, course: "Course", ops: Ops) -> Scalar:  # noqa: D102
        return self._mix_all([rate], [self.effect.steering_rate(rate, course, ops)])[0]

    def drive_rate(self, rate: Scalar, course: "Course", ops: Ops) -> Scalar:  # noqa: D102
        return self._mix_all([rate], [self.effect.drive_rate(rate, course, ops)])[0]

    def rates(self, course: "Course", ops: Ops) -> Sequence[Scalar]:  # noqa: D102
        return self.effect.rates(course, ops)

    def measure(self, channels: Mapping[str, Scalar], ops: Any) -> Mapping[str, Scalar]:  # noqa: D102
        return {name: self._mix(channels[name], shown) for name, shown in self.effect.measure(channels, ops).items()}


def only_shifts(effect: Effect) -> bool:
    """Return whether an effect does nothing but make channels late."""
    return bool(effect.delays() or effect.latencies())


def with_all(vehicle: Vehicle, catalogue: Mapping[str, Effect]) -> Vehicle:
    """Return the vehicle with every effect of the catalogue in it: absent, unless the vehicle has it."""
    effects = {
        name: Present(effect=vehicle.effects.get(name, effect), presence=float(name in vehicle.effects))
        for name, effect in {**catalogue, **vehicle.effects}.items()
        if not only_shifts(effect)
    }
    return replace(vehicle, effects=effects)


def inner(name: str) -> str:
    """Return an effect's parameter's name in a vehicle that `with_all` made."""
    parts = name.split(".")
    return ".".join(["effects", parts[1], "effect", *parts[2:]]) if parts[0] == "effects" else name
