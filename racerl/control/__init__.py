"""Controllers: anything that drives a race."""

from typing import TYPE_CHECKING, Protocol

from torch import Tensor

if TYPE_CHECKING:
    from racerl.env.race import Race


class Controller(Protocol):
    """Chooses actions for all cars of a race."""

    @property
    def name(self) -> str:
        """What reports call it."""

    def act(self, race: "Race") -> Tensor:
        """Return actions (N, 2) in [−1, 1]."""
