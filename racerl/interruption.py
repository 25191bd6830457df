"""Being asked to stop: Ctrl-C, SIGTERM (`kill`, a cluster) and SIGHUP (a closed terminal) end a command the same way.

Where a loop could lose work, it holds the first of these back until it has kept what it knows; the second ends it
at once. A signal that is ignored, as under `nohup`, stays ignored.
"""

import logging
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from types import FrameType
from typing import Any

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGUSR2)  # the last is how Slurm's jobs are asked

Handler = Callable[[int, FrameType | None], Any] | int | None

log = logging.getLogger(__name__)


class Terminated(KeyboardInterrupt):
    """Asked to end by a signal other than Ctrl-C's."""

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.number = number


def _end(number: int, frame: FrameType | None) -> None:
    raise Terminated(number)


def listen() -> None:
    """From now on, let SIGTERM and SIGHUP end this process as Ctrl-C does: folders swept, Ctrl-C's words said."""
    for number in (signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _end)


def behind(error: BaseException | None) -> KeyboardInterrupt | None:
    """Return the interruption behind an error: libraries in C may raise another one where they are asked to stop."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error


@contextmanager
def not_swallowed() -> Iterator[None]:
    """Let an interruption go on that a library in C ends its work for, but does not raise."""
    asked: list[Callable[[], Any]] = []

    def hear(before: Callable[[int, FrameType | None], Any], number: int, frame: FrameType | None) -> None:
        asked.append(lambda: before(number, None))
        before(number, frame)

    handlers = {}
    if threading.current_thread() is threading.main_thread():
        handlers = {number: before for number in SIGNALS if callable(before := signal.getsignal(number))}
    for number, before in handlers.items():
        signal.signal(number, partial(hear, before))
    try:
        yield
    finally:
        for number, before in handlers.items():
            signal.signal(number, before)
        for again in asked[:1]:
            again()


class Held:
    """The signal that was held back, if any has come."""

    def __init__(self) -> None:
        self.number: int | None = None
        self.before: dict[signal.Signals, Handler] = {}

    def __bool__(self) -> bool:
        return self.number is not None

    def hear(self, number: int, frame: FrameType | None) -> None:
        """Hold the first signal back, hand on the second; what a closing terminal or a cluster sends beside is none."""
        if self.number is None:
            log.warning("asked to stop: keeping what is done; ask again to leave at once")
            self.number = number
        elif number != signal.SIGHUP and (number == self.number or signal.SIGINT in (number, self.number)):
            first, self.number = self.number, None
            self._hand_on(number, frame)
            self.number = first

    def release(self) -> None:
        """Hand a signal that was held back to whom it was for, who will raise mostly."""
        if self.number is not None:
            number, self.number = self.number, None
            self._hand_on(number, None)

    def _hand_on(self, number: int, frame: FrameType | None) -> None:
        before = self.before[signal.Signals(number)]
        if callable(before):
            before(number, frame)
        else:  # the system's own way, which is to end without a word
            _end(number, frame)


@contextmanager
def held_back() -> Iterator[Held]:
    """Hold signals back; whoever asks for it must look whether one has come, keep its work and `release` it."""
    held = Held()
    if threading.current_thread() is threading.main_thread():
        for number in SIGNALS:
            before = signal.getsignal(number)
            ours = number != signal.SIGUSR2 or callable(before)  # nobody's, but where a cluster's job listens to it
            if ours and before is not signal.SIG_IGN and before is not None:
                held.before[number] = before
                signal.signal(number, held.hear)
    try:
        yield held
    finally:
        for one, before in held.before.items():
            signal.signal(one, before)
        held.release()
