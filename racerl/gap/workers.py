"""Threads that fit candidates side by side; their number changes nothing."""

from collections.abc import Callable, Sequence
from concurrent.futures import CancelledError, ThreadPoolExecutor
from dataclasses import dataclass, field
from threading import Event
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")


@dataclass(frozen=True, eq=False)
class Workers:
    """So many threads, and whether one of them has failed."""

    threads: int = 1
    stopped: Event = field(default_factory=Event)

    def each(
        self,
        function: Callable[[Item], Result],
        items: Sequence[Item],
        on_progress: Callable[[Item, float], None] = lambda item, share: None,
    ) -> list[Result]:
        """Return a function of every item, in their order.

        Where one fails, or the user interrupts, the others end before their next fit.
        """
        results = []
        with ThreadPoolExecutor(self.threads) as pool:
            try:
                for item, result in zip(items, pool.map(function, items), strict=True):
                    results.append(result)
                    on_progress(item, len(results) / len(items))
            except BaseException:
                self.stopped.set()
                raise
        return results

    def go_on(self) -> None:
        """Raise CancelledError where another thread has failed or was interrupted."""
        if self.stopped.is_set():
            raise CancelledError
