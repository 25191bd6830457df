"""Benchmarks, one file each; module `identify` holds the class `Identify`. Ratios are taken in one run."""

from collections.abc import Callable
from typing import Any, Protocol

from racerl.run import Compose as Compose

Progress = Callable[[float, str], None]


class Benchmark(Protocol):
    """Measures and returns plain numbers; `on_progress(share, what)` hears how far it is."""

    def measure(self, compose: Compose, threads: int, on_progress: Progress) -> dict[str, Any]:
        """Return what was measured."""
