"""Threads that fit candidates side by side, or a single fit's windows; their number changes nothing."""

from collections.abc import Callable, Sequence
from concurrent.futures import CancelledError, ThreadPoolExecutor
from dataclasses import dataclass, field
from threading import Event, local
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")


@dataclass(frozen=True, eq=False)
class Workers:
    """So many threads, and whether one of them has failed."""

    threads: int = 1
    stopped: Event = field(default_factory=Event)
    _mine: local = field(default_factory=local, init=False, repr=False)

    @property
    def spare(self) -> int:
        """Number of threads that whatever runs here may use: all, or its share beside others."""
        return int(getattr(self._mine, "threads", self.threads))

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
        share = max(1, self.spare // max(1, len(items)))
        with ThreadPoolExecutor(self.spare, initializer=self._keep_to, initargs=(share,)) as pool:
            try:
                for item, result in zip(items, pool.map(function, items), strict=True):
                    results.append(result)
                    on_progress(item, len(results) / len(items))
            except BaseException:
                self.stopped.set()
                raise
        return results

    def _keep_to(self, threads: int) -> None:
        """Let what runs in the calling thread use so many."""
        self._mine.threads = threads

    def go_on(self) -> None:
        """Raise CancelledError where another thread has failed or was interrupted."""
        if self.stopped.is_set():
            raise CancelledError
