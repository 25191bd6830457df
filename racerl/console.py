"""What a user sees while a stage works: a live bar on a terminal, plain lines elsewhere."""

import time
from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

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


def training_remark(progress: TrainProgress) -> str:
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
