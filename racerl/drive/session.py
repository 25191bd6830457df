"""The course of a drive: practice, then a counted session, then the end. Pure: no window, no wall clock.

Laps are timed and scored as an evaluation's. From the start of the counted session on everything counts: a crash costs
the lap, one on the way to the first line too. The delta is the time lost on the best valid lap of the drive, practice
included, at the same distance from the line.
"""

from enum import Enum

import numpy as np

from racerl.evaluate.laps import Lap, LapTimer


class Phase(Enum):
    """What is being driven; the values stand in the log."""

    PRACTICE = "practice"
    COUNTED = "counted"
    FINISHED = "finished"


class Trace:
    """The time since the line over the distance from it, of one lap."""

    def __init__(self, line: float) -> None:
        self.line = line  # m, where the lap began
        self.distance, self.elapsed = [0.0], [0.0]  # m, s

    def add(self, travelled: float, elapsed: float) -> None:
        """Take in a place further on than those before; a car that rolls back adds none."""
        if travelled - self.line > self.distance[-1]:
            self.distance.append(travelled - self.line)
            self.elapsed.append(elapsed)

    def behind(self, best: "Trace") -> float:
        """Return the time lost on another lap up to here, in s."""
        return self.elapsed[-1] - float(np.interp(self.distance[-1], best.distance, best.elapsed))


class Session:
    """One car's drive; `travelled` is always the unwrapped distance along the centreline in m."""

    def __init__(self, length: float, dt: float, laps: int, travelled: float) -> None:
        self.length, self.dt, self.laps = length, dt, laps
        self.phase = Phase.PRACTICE
        self.paused = False
        self.standing = True  # put on the track; the clock waits for the throttle
        self.seconds = 0.0  # driven, in this phase
        self.last: Lap | None = None
        self.best: Lap | None = None
        self._best: Trace | None = None
        self._begin(travelled)

    def count(self, travelled: float) -> None:
        """Begin the counted session; its first lap begins at the next line."""
        self.phase = Phase.COUNTED
        self._begin(travelled)

    def moves(self, pedal: float) -> bool:
        """Tell whether the car drives on, given the pedal in −1 … 1: where it was put, it waits for the throttle."""
        if self.paused or self.phase is Phase.FINISHED:
            return False
        self.standing = self.standing and pedal <= 0.0
        return not self.standing

    def update(self, before: float, after: float, margin: float, crashed: bool, restart: float) -> None:
        """Take in one control step.

        The distance `before` and `after` it, the margin to the boundary after it in m, whether it ended in a crash, and
        the distance from which the car goes on.
        """
        done = len(self.driven)
        self._timer.update(*(np.array([value]) for value in (before, after, margin, crashed, restart)))
        self.seconds += self.dt
        self.standing = crashed
        if len(self.driven) > done:
            self._close(self.driven[-1])
        self._follow(after)
        if self.phase is Phase.COUNTED and len(self.driven) >= self.laps:
            self.phase = Phase.FINISHED

    @property
    def driven(self) -> list[Lap]:
        """The laps of this phase."""
        return self._timer.laps[0]

    @property
    def counted(self) -> list[Lap]:
        """The laps that are scored."""
        return [] if self.phase is Phase.PRACTICE else self.driven

    @property
    def lap(self) -> int:
        """Number of the counted lap that is being driven; 0 in practice and on the way to the line."""
        return 0 if self.phase is Phase.PRACTICE else self._number

    @property
    def elapsed(self) -> float | None:
        """Time on the flying lap that is being driven, in s; None on the way to the line."""
        return float(self._timer.elapsed()[0]) if self._number else None

    @property
    def delta(self) -> float | None:
        """Time lost on the best lap up to here, in s; None without one, and on the way to the line."""
        return self._trace.behind(self._best) if self._trace and self._best else None

    def _begin(self, travelled: float) -> None:
        self._timer = LapTimer(self.length, self.dt, np.array([travelled]))
        self._number, self._trace = 0, None  # type: int, Trace | None
        self.seconds = 0.0

    def _close(self, lap: Lap) -> None:
        self.last = lap
        time = lap.time_s if lap.valid else None
        if time is None or self._trace is None:
            return
        self._trace.add(self._trace.line + self.length, time)
        if self._best is None or time < self._best.elapsed[-1]:
            self.best, self._best = lap, self._trace

    def _follow(self, travelled: float) -> None:
        """Keep the trace of the lap under way, a fresh one from every line."""
        number = int(self._timer.current()[0])
        if number != self._number:
            self._number = number
            self._trace = Trace(np.floor(travelled / self.length) * self.length) if number else None
        if self._trace:
            self._trace.add(travelled, float(self._timer.elapsed()[0]))
