"""What effects of time share: a clock, and an age that levels off."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from racerl.vehicle.effects import Effect
from racerl.vehicle.ops import Ops, Scalar

if TYPE_CHECKING:
    from racerl.vehicle.vehicle import Course


@dataclass(frozen=True, kw_only=True)
class Ageing(Effect):
    """An effect that grows from the drive's beginning on, in the end more slowly.

    τ stands in the subclasses, since the first parameter of an effect is its size.
    """

    states: ClassVar[tuple[str, ...]] = ("clock",)
    told: ClassVar[tuple[str, ...]] = states
    uniform: ClassVar[bool] = False

    def age(self, own: Mapping[str, Scalar], time: Scalar, ops: Ops) -> Scalar:
        """Return τ (1 − exp(−t/τ)) in s: t at first, τ in the end."""
        aged: Scalar = time * (1.0 - ops.exp(-own[self.key("clock")] / time))
        return aged

    def rates(self, course: "Course", ops: Ops) -> Sequence[Scalar]:
        """Return the rate of time."""
        return (1.0 + 0.0 * course.motion.v_x,)
