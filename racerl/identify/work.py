"""How much of several fits is done, when nobody knows how many steps each will take."""

from collections.abc import Callable, Sequence

Progress = Callable[[float, str], None]  # share and remark

GUESS = 15.0  # steps of a fit, before any has been seen


class Work:
    """Counts steps over fits planned as (place, windows); tells a share of 0 … 1 that only grows.

    A fit is taken to need as many steps as those before it at the same place, be it a start or a later round; where
    there are none, as many as all before it.
    """

    def __init__(self, plan: Sequence[tuple[int, int]], on_share: Progress = lambda share, remark: None) -> None:
        self._ahead, self._count, self._on_share = list(plan), len(plan), on_share
        self._seen: dict[int, list[int]] = {}
        self._done = self._share = 0.0
        self._steps = 0

    def step(self, iteration: int, cost: float) -> None:
        """Count a step of the fit at work."""
        self._steps = iteration
        self._tell()

    def finish(self) -> None:
        """Count the fit at work as done."""
        if self._ahead:
            place, windows = self._ahead.pop(0)
            self._seen.setdefault(place, []).append(self._steps)
            self._done += windows * self._steps
            self._steps = 0
            self._tell()

    def _tell(self) -> None:
        done = self._done + (self._ahead[0][1] * self._steps if self._ahead else 0)
        total = self._done + sum(windows * self._expected(place) for place, windows in self._ahead)
        self._share = max(self._share, done / total if total else 0.0)
        at = min(self._count - len(self._ahead) + 1, self._count)
        self._on_share(self._share, f"fit {at} of {self._count}")

    def _expected(self, place: int) -> float:
        seen = self._seen.get(place)
        known = seen or [steps for every in self._seen.values() for steps in every]
        expected = sum(known) / len(known) if known else GUESS
        # the fit at work takes at least one step more, and so will those that are like it as far as is known
        return max(expected, self._steps + 1) if not seen or place == self._ahead[0][0] else expected
