"""What a user sees while a stage works: a live bar on a terminal, plain lines elsewhere."""

import time
from collections.abc import Sequence
from types import TracebackType
from typing import TYPE_CHECKING

from rich.console import Console
from rich.live import Live
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

if TYPE_CHECKING:
    from racerl.sweep.engine import Status
    from racerl.train.session import Progress as TrainProgress

PLAIN_PERIOD = 10.0  # s between lines without a terminal


class Bar:
    """A progress bar with a changing remark; a line every 10 s when nobody watches."""

    def __init__(self, console: Console, title: str) -> None:
        self.console, self.title = console, title
        self._printed = -PLAIN_PERIOD
        self._progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(bar_width=24),
            TextColumn("{task.percentage:3.0f} %"),
            TextColumn("{task.fields[remark]}"),
            TextColumn("left"),
            TimeRemainingColumn(elapsed_when_finished=True),
            console=console,
            disable=not console.is_terminal,
        )
        self._task = self._progress.add_task(title, total=1.0, remark="")

    def __enter__(self) -> "Bar":
        self._progress.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._progress.stop()

    def show(self, share: float, remark: str, seconds_left: float | None = None) -> None:
        """Update to a share in 0 … 1."""
        self._progress.update(self._task, completed=share, remark=remark)
        if not self.console.is_terminal and time.monotonic() - self._printed >= PLAIN_PERIOD:
            self._printed = time.monotonic()
            left = f", {seconds_left:.0f} s left" if seconds_left is not None else ""
            self.console.print(f"{self.title} {share:4.0%}  {remark}{left}", highlight=False, soft_wrap=True)


class Board:
    """The jobs of a sweep: a live table of those at work on a terminal, plain lines elsewhere."""

    def __init__(self, console: Console) -> None:
        self.console = console
        self._live = Live(console=console, refresh_per_second=2, transient=True) if console.is_terminal else None
        self._printed = -PLAIN_PERIOD
        self._kinds: dict[str, str] = {}

    def __enter__(self) -> "Board":
        if self._live:
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._live:
            self._live.stop()

    def show(self, rows: "Sequence[Status]") -> None:
        """Update to where the jobs are."""
        for row in rows:
            if self._kinds.get(row.job.name) == "running" and row.kind in ("done", "failed"):
                self.console.print(f"{row.job.name}: {row.kind}", highlight=False)
            self._kinds[row.job.name] = row.kind
        count = {kind: sum(row.kind == kind for row in rows) for kind in ("done", "running", "waiting", "failed")}
        head = ", ".join(f"{number} {kind}" for kind, number in count.items() if number or kind == "done")
        running = [row for row in rows if row.kind == "running"]
        if self._live:
            table = Table("job", "done", "steps/s", "lap [s]", "left", title=f"{len(rows)} jobs: {head}")
            for row in running:
                table.add_row(row.job.name, *_cells(row))
            self._live.update(table)
        elif time.monotonic() - self._printed >= PLAIN_PERIOD:
            self._printed = time.monotonic()
            at_work = "; ".join(f"{row.job.name} {_cells(row)[0]}" for row in running)
            self.console.print(f"sweep: {head}. {at_work}".rstrip(" ."), highlight=False, soft_wrap=True)


def _cells(row: "Status") -> tuple[str, str, str, str]:
    """Return what is known of a running job: share done, steps per second, lap, time left."""
    told = row.told
    rate, lap, left = (told.get(key) for key in ("steps_per_s", "lap_s", "seconds_left"))
    return (
        f"{told.get('share', 0.0):.0%} {told.get('remark', 'starting')}",
        f"{rate:,.0f}" if rate else "–",
        f"{lap:.2f}" if lap else "–",
        f"{left / 60:.0f} min" if left is not None else "–",
    )


def training_remark(progress: "TrainProgress") -> str:
    """Return steps/s, reward and the current evaluation lap in one line."""
    evaluation = progress.evaluation
    lap = "no lap yet"
    if evaluation:
        mean = evaluation["mean_lap_s"]
        lap = f"lap {mean:.2f} s" if mean else "no clean lap"
        lap += f", crashes {evaluation['crash_share']:.0%}"
    return (
        f"{progress.steps / 1e6:.2f} M steps, {progress.steps_per_s:,.0f} steps/s, reward {progress.reward:+.3f}, {lap}"
    )
