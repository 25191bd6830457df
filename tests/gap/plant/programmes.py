"""How the cars are driven: an excitation programme, race laps, and logs too poor to tell anything.

A programme is a list of runs; a run has a start pose, a start speed and a driver that gives δ_ref in rad, ω_ref in m/s,
(2, B), every 20 ms. Every case has its own random generator, so that a log doesn't depend on its batch.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from tests.gap.plant import manoeuvres
from tests.gap.plant.car import Lean
from tests.gap.plant.manoeuvres import DURATION, EXCITATION, Manoeuvre, wander
from tests.gap.plant.track import Track, TrackLean, bowl, kidney, speed_profile
from tests.gap.plant.tyre import Array

COMMAND_PERIOD = 0.02  # s
FULL_LOCK = 0.36  # rad
LOST = 1.5  # m off the centre line, from where a driver looks for the track anew
GRIP = 4.2  # m/s², what the published car corners with at full effort
Driver = Callable[[float, Array], Array]
Generators = Sequence[np.random.Generator]


@dataclass(frozen=True)
class Run:
    """One unbroken stretch of driving."""

    duration: float  # s
    pose: Array  # x, y, yaw, (3, B)
    speed: Array  # m/s, (B,)
    driver: Driver


@dataclass(frozen=True)
class Programme:
    """How to make the runs, and the ground they are driven on."""

    runs: Callable[[dict[str, Array], Generators, float, str], list[Run]]  # cars, generators, minutes, direction
    minutes: float
    lean: Lean
    landmark: tuple[float, float]  # m, a place that is passed often


class Tape:
    """A driver who plays commands back, (n, 2, B), and holds the last."""

    def __init__(self, commands: Array) -> None:
        self.commands = commands

    def __call__(self, t: float, state: Array) -> Array:
        """The commands at t s since the run began; the first before that."""
        return self.commands[min(max(round(t / COMMAND_PERIOD), 0), len(self.commands) - 1)]


def play(manoeuvre: Manoeuvre, duration: float, rngs: Generators) -> Run:
    """A run of open-loop commands, each car's amplitudes, times and start drawn within some per cent."""
    t = np.arange(round(duration / COMMAND_PERIOD)) * COMMAND_PERIOD
    tapes, poses = [], []
    for rng in rngs:
        delta, omega = manoeuvre.commands(t * rng.uniform(0.96, 1.04), rng)
        turned = np.clip(delta * rng.uniform(0.95, 1.05), -FULL_LOCK, FULL_LOCK)
        tapes.append(np.stack([turned, omega * rng.uniform(0.96, 1.04)], axis=1))
        poses.append(np.array(manoeuvre.start) + rng.normal(0.0, (0.15, 0.15, 0.05)))
    commands = np.stack(tapes, axis=-1)
    return Run(duration, np.stack(poses, axis=-1), commands[0, 1], Tape(commands))


def excitation(cars: dict[str, Array], rngs: Generators, minutes: float, direction: str) -> list[Run]:
    """Runs of 15 s: at five minutes all twenty manoeuvres, which together excite everything, else an even choice."""
    count = max(round(minutes * 60 / DURATION), 1)
    chosen = [(i * len(EXCITATION) // count if count < len(EXCITATION) else i) for i in range(count)]
    return [play(EXCITATION[i % len(EXCITATION)], DURATION, rngs) for i in chosen]


def race(cars: dict[str, Array], rngs: Generators, minutes: float, direction: str) -> list[Run]:
    """Laps in three runs; the second goes the other way round where the direction is "both"."""
    forward = kidney()
    ways = [forward, forward.reversed() if direction == "both" else forward, forward]
    return [_laps(track, cars, rngs, minutes * 20) for track in ways]


def slow(cars: dict[str, Array], rngs: Generators, minutes: float, direction: str) -> list[Run]:
    """Pottering about below 1 m/s with hardly any steering, in two runs."""
    return [play(Manoeuvre(manoeuvres.pottering, (0.0, 0.0, 0.0)), minutes * 30, rngs) for _ in range(2)]


def still(cars: dict[str, Array], rngs: Generators, minutes: float, direction: str) -> list[Run]:
    """Standing with the log running."""
    return [play(Manoeuvre(manoeuvres.standing, (0.0, 0.0, 0.0)), minutes * 60, rngs)]


def short(cars: dict[str, Array], rngs: Generators, minutes: float, direction: str) -> list[Run]:
    """Some seconds of ordinary driving."""
    return [play(Manoeuvre(manoeuvres.strolling, (0.0, 0.0, 0.0)), minutes * 60, rngs)]


def circles(cars: dict[str, Array], rngs: Generators, minutes: float, direction: str) -> list[Run]:
    """Throttle ramps on two circles, both ways round, eight runs: the steering never moves."""
    angles = (0.15, -0.15, 0.3, -0.3)
    return [
        play(Manoeuvre(manoeuvres.ramping(angles[i % 4]), (0.0, 0.0, 0.0)), minutes * 60 / 8, rngs) for i in range(8)
    ]


def _laps(track: Track, cars: dict[str, Array], rngs: Generators, duration: float) -> Run:
    """One run of laps from a random place on the circuit."""
    start = np.array([rng.integers(len(track.x)) for rng in rngs])
    racer = Racer(track, start, cars, rngs, duration)
    pose = np.stack([track.x[start], track.y[start], track.heading[start]])
    return Run(duration, pose, 0.8 * racer.profile(start), racer)


class Racer:
    """A human-like driver: pure pursuit of a wandering line, a speed profile at 75–90 % of grip, caution when off line.

    δ_ref = atan(2 L sin η/d)(1 + 0.03 v²) with d = 0.45 m + 0.22 s·v and η the angle to the point d ahead.
    """

    def __init__(self, track: Track, start: Array, cars: dict[str, Array], rngs: Generators, duration: float) -> None:
        t = np.arange(round(duration / COMMAND_PERIOD) + 1) * COMMAND_PERIOD
        self.track, self.index = track, start
        self.wheelbase = cars["wheelbase"]
        self.grip = np.array([rng.uniform(0.75, 0.9) for rng in rngs]) * GRIP * cars["friction"] / 0.8
        self.unit_speed = speed_profile(track)
        self.line = np.stack([wander(t, rng, 0.18, (2.5, 9.0)) for rng in rngs], axis=-1)  # m left of the centre
        self.mood = np.stack([wander(t, rng, 0.04, (3.0, 15.0)) for rng in rngs], axis=-1)  # share of the speed
        self.tremor = np.stack([wander(t, rng, 0.008, (0.3, 1.0)) for rng in rngs], axis=-1)  # rad
        self.trust = np.full(len(rngs), 0.88)  # share of the planned speed dared, from what happened so far

    def profile(self, index: Array) -> Array:
        """Speed in m/s planned at points of the track, (B,)."""
        return np.minimum(np.sqrt(self.grip) * self.unit_speed[index % len(self.track.x)], 5.0)

    def __call__(self, t: float, state: Array) -> Array:
        """Steering and speed at t s since the run began, from the true state (n, B)."""
        x, y, yaw, v_x = state[:4]
        k = min(max(round(t / COMMAND_PERIOD), 0), len(self.line) - 1)
        self._locate(x, y)
        angle, distance = self._bearing(x, y, yaw, 0.45 + 0.22 * np.abs(v_x), self.line[k])
        steer = np.arctan(2 * self.wheelbase * np.sin(angle) / distance) * (1 + 0.03 * v_x**2) + self.tremor[k]
        ahead = self.profile(self.index + np.rint(0.12 * np.abs(v_x) / self.track.spacing).astype(int))
        speed = ahead * (1 + self.mood[k]) * self._confidence(x, y, angle, state[4] / np.maximum(v_x, 1.0))
        return np.stack([np.clip(steer, -FULL_LOCK, FULL_LOCK), np.maximum(speed, 0.6)])

    def _locate(self, x: Array, y: Array) -> None:
        """Move each car's index to the nearest point within a window about the last."""
        window = (self.index + np.arange(-15, 26)[:, None]) % len(self.track.x)
        nearest = np.hypot(self.track.x[window] - x, self.track.y[window] - y).argmin(axis=0)
        self.index = np.take_along_axis(window, nearest[None], axis=0)[0]
        for car in np.flatnonzero(self._off(x, y) > LOST):
            self.index[car] = np.hypot(self.track.x - x[car], self.track.y - y[car]).argmin()

    def _bearing(self, x: Array, y: Array, yaw: Array, look: Array, offset: Array) -> tuple[Array, Array]:
        """Angle from the car's axis to the point on the line `look` m ahead, rad, and its distance, m."""
        target = (self.index + np.rint(look / self.track.spacing).astype(int)) % len(self.track.x)
        heading = self.track.heading[target]
        dx = self.track.x[target] - offset * np.sin(heading) - x
        dy = self.track.y[target] + offset * np.cos(heading) - y
        angle = np.arctan2(dy, dx) - yaw
        return np.arctan2(np.sin(angle), np.cos(angle)), np.maximum(np.hypot(dx, dy), 0.3)

    def _confidence(self, x: Array, y: Array, angle: Array, sliding: Array) -> Array:
        """Share of the planned speed: less when off the line or astray, and for some laps after that or a slide."""
        off, astray = self._off(x, y), np.abs(angle)
        trouble = (off > 0.9) | (astray > 0.8) | (np.abs(sliding) > 0.35)
        self.trust = np.clip(self.trust * np.where(trouble, 0.985, 1.00005), 0.5, 1.0)
        return self.trust * np.clip(1.35 - 0.6 * np.maximum(off, 0.6), 0.4, 1.0) * np.clip(1.5 - astray, 0.4, 1.0)

    def _off(self, x: Array, y: Array) -> Array:
        """Distance from the centre line, m."""
        return np.hypot(self.track.x[self.index] - x, self.track.y[self.index] - y)


PROGRAMMES: dict[str, Programme] = {
    "excitation": Programme(excitation, 5.0, bowl, (0.0, 0.0)),
    "race": Programme(race, 5.0, TrackLean(kidney()), (4.5, 0.2)),
    "circles": Programme(circles, 128 / 60, bowl, (0.0, 0.0)),
    "slow": Programme(slow, 2.0, bowl, (0.0, 0.0)),
    "still": Programme(still, 0.5, bowl, (0.0, 0.0)),
    "short": Programme(short, 8 / 60, bowl, (0.0, 0.0)),
}
