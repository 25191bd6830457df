"""What a user sees while a stage works: a live bar on a terminal, plain lines elsewhere."""

import time
from collections.abc import Sequence
from contextlib import ExitStack
from types import TracebackType
from typing import TYPE_CHECKING

from rich.console import Console
from rich.live import Live
from rich.progress import BarColumn, Progress, ProgressColumn, Task, TextColumn
from rich.table import Table
from rich.text import Text

from racerl.vehicle.compiler import telling

if TYPE_CHECKING:
    from racerl.sweep.engine import Status
    from racerl.train.session import Progress as TrainProgress

PLAIN_PERIOD = 10.0  # s between lines without a terminal
COMPILING = "compiling for this machine, once"
SETTLING = 3.0  # s before which nothing is said of the time left


class Bar:
    """A progress bar with a changing remark; a line every 10 s when nobody watches. It only goes forward."""

    def __init__(self, console: Console, title: str) -> None:
        self.console, self.title = console, title
        self.left = Left()
        self._share = 0.0
        self._printed = -PLAIN_PERIOD
        self._progress = Progress(
            TextColumn("{task.description}", markup=False),
            BarColumn(bar_width=24),
            TextColumn("{task.percentage:3.0f} %"),
            TextColumn("{task.fields[remark]}", markup=False),
            _LeftColumn(self.left),
            console=console,
            disable=not console.is_terminal,
        )
        self._task = self._progress.add_task(title, total=1.0, remark="")
        self._shown = ExitStack()

    def __enter__(self) -> "Bar":
        self._shown.enter_context(self._progress)
        self._shown.enter_context(telling(lambda: self._progress.update(self._task, remark=COMPILING)))
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._shown.__exit__(kind, error, trace)

    def begin(self, title: str) -> None:
        """Begin anew with the next part of the work."""
        self.title, self._share, self._printed = title, 0.0, -PLAIN_PERIOD
        self._progress.update(self._task, description=title, completed=0.0, remark="")

    def show(self, share: float, remark: str, seconds_left: float | None = None) -> None:
        """Update to a share in 0 … 1; a smaller one than before leaves the bar where it is."""
        self._share = max(self._share, share)
        self.left.hear(self._share, seconds_left)
        self._progress.update(self._task, completed=self._share, remark=remark)
        if not self.console.is_terminal and time.monotonic() - self._printed >= PLAIN_PERIOD:
            self._printed = time.monotonic()
            left = "" if (seconds := self.left.seconds()) is None else f", {clock(seconds)} left"
            line = f"{self.title} {self._share:4.0%}  {remark}{left}"
            self.console.print(line, highlight=False, soft_wrap=True)


class Left:
    """The time left, from the mean pace since the first share heard, which may stand for work of an earlier run."""

    def __init__(self) -> None:
        self._first: tuple[float, float] | None = None  # s, share
        self._share = 0.0
        self._told: float | None = None

    def hear(self, share: float, told: float | None = None) -> None:
        """Take in the share done, and the seconds left where the stage knows better."""
        self._first = self._first or (time.monotonic(), share)
        self._share, self._told = share, told

    def seconds(self) -> float | None:
        """Return the seconds left; None while nothing can be said."""
        if self._told is not None or self._first is None:
            return self._told
        taken, done = time.monotonic() - self._first[0], self._share - self._first[1]
        return None if taken < SETTLING or done <= 0 else taken * (1.0 - self._share) / done


class _LeftColumn(ProgressColumn):
    """The time left, or what it took in the end."""

    def __init__(self, left: Left) -> None:
        super().__init__()
        self.left = left

    def render(self, task: Task) -> Text:
        """Return the column's text."""
        if task.finished:
            return Text(f"in {clock(task.finished_time or 0.0)}")
        seconds = self.left.seconds()
        return Text("" if seconds is None else f"{clock(seconds)} left")


def clock(seconds: float) -> str:
    """Return a duration as h:mm:ss or m:ss."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"


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
        clean = evaluation["valid_laps"] / max(evaluation["laps"], 1)
        lap = f"lap {mean:.2f} s, {clean:.0%} clean" if mean else "no finished lap"
        lap += f", crashes {evaluation['crash_share']:.0%}"
    return (
        f"{progress.steps / 1e6:.2f} M steps, {progress.steps_per_s:,.0f} steps/s, reward {progress.reward:+.3f}, {lap}"
    )
