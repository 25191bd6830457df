"""The score test: what first-order theory says of every effect of the catalogue, in one pass over the log."""

import functools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from racerl.estimation.unknowns import Unknown
from racerl.gap.follow import follow
from racerl.gap.normal_equations import Linear
from racerl.gap.presence import only_shifts
from racerl.gap.stage import SHIFTS
from racerl.gap.stage_problem import StageProblem
from racerl.vehicle.vehicle import STATE

SHOWS = 30.0  # first-order gain, a χ², that is no chance
FELT = 0.01  # of the noise's cost, that an effect must take: nobody misses less, however sure it is
REMAINDER = 0.03  # the same, of what a tyre of another formula leaves
ONE = 0.9995  # |cosine| above which two effects are one in this log, for want of a stage that tells

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Score:
    """What first-order theory says of adding effects at their usual sizes: H and g over their presences."""

    names: list[str]
    H: Array
    g: Array
    least: Array | None = None  # gains (E,) below which nobody would miss an effect

    def gains(self) -> dict[str, float]:
        """Return by how much the cost would fall with each effect alone, at its best size of either sign."""
        stiffness = np.maximum(np.diag(self.H), 1e-12)
        return dict(zip(self.names, (self.g**2 / stiffness).tolist(), strict=True))

    def cosines(self) -> Array:
        """Return how alike effects look in this data, (E, E): ± 1 cannot be told apart."""
        size = np.sqrt(np.maximum(np.diag(self.H), 1e-12))
        cosine: Array = self.H / np.outer(size, size)
        return cosine

    def hidden(self) -> tuple[str, ...]:
        """Return the effects that would not show at their usual size: lost in chance, or too small to be missed."""
        least = np.full(len(self.names), SHOWS) if self.least is None else np.maximum(self.least, SHOWS)
        return tuple(name for name, low in zip(self.names, np.diag(self.H) < least, strict=True) if low)

    def one(self, name: str, other: str) -> bool:
        """Return whether two effects that show are one in this log."""
        if name == other or not {name, other} <= set(self.names):
            return False
        if any(self.H[i, i] < SHOWS for i in map(self.names.index, (name, other))):
            return False
        return bool(abs(self.cosines()[self.names.index(name), self.names.index(other)]) > ONE)

    def likeness(self, name: str, others: Iterable[str]) -> float:
        """Return the largest |cosine| of an effect with some others, 0 with none."""
        known = [self.names.index(other) for other in others if other in self.names]
        if name not in self.names or not known:
            return 0.0
        return float(np.abs(self.cosines()[self.names.index(name), known]).max())


def score(
    problem: StageProblem, unknowns: Sequence[Unknown], theta: Mapping[str, float], initial: Array, strength: float
) -> Score:
    """Return the score of all effects that the kernel knows and the vehicle lacks.

    The sensitivities to the stage's unknowns, inside priors of the strength λ that the fit had, and to every window's
    initial state are projected out: what they can explain does not count for an effect.
    """
    rollout, size = problem.rollout, len(problem.rollout.names)
    car = problem.everything(theta)
    absent = [name for name in problem.kernel.catalogue if name not in problem.vehicle.effects]
    columns = {f"effects.{name}.presence": name for name in absent if f"effects.{name}.presence" in rollout.names}
    windows = problem.windows(theta)
    windows.initial[: len(STATE)] = initial[: len(STATE)]
    windows.initial[len(STATE) :] = follow(car, problem.evidence, problem.shifts(theta))[:, problem.evidence.start]
    present = [size + i for i, name in enumerate(rollout.active) if problem.has(name)]
    asked = [*range(size), *present]
    parts = rollout.accumulate(problem.parameters(theta), windows, columns=asked, silent=problem.silent())
    trust = np.array([problem.evidence.trust(rollout.active[i - size]) for i in present])
    line = Linear.of(parts, size, problem.evidence)
    line = replace(line, xx=line.xx + np.diag(trust))
    H, g = (part.sum(axis=0) for part in line.reduced(0.0))
    picked = np.zeros((size, len(absent)))
    for k, name in enumerate(absent):
        picked[:, k] = _direction(problem, rollout.names, name, columns)
    # what stands at a bound cannot give way
    known = [u for u in unknowns if u.name in problem.names and u.low < theta[u.name] < u.high]
    free = problem.mixing[:, [problem.names.index(u.name) for u in known]]
    precision = np.array([u.sigma**-2.0 * (1.0 if u.effect else strength) for u in known])
    slope = free.T @ g + precision * np.array([theta[u.name] - u.start for u in known])
    shared = free.T @ H @ picked
    moved = np.linalg.solve(free.T @ H @ free + np.diag(precision), np.column_stack([shared, slope]))
    return Score(absent, picked.T @ H @ picked - shared.T @ moved[:, :-1], picked.T @ g - shared.T @ moved[:, -1])


def summed(scores: Iterable[Score]) -> Score:
    """Return the sum of some stages' scores, over the effects of any."""
    return functools.reduce(_merged, scores)


def _merged(one: Score, other: Score) -> Score:
    names = [*one.names, *(name for name in other.names if name not in one.names)]
    H, g, least = np.zeros((len(names), len(names))), np.zeros(len(names)), np.zeros(len(names))
    for part in (one, other):
        place = [names.index(name) for name in part.names]
        H[np.ix_(place, place)] += part.H
        g[place] += part.g
        least[place] += 0.0 if part.least is None else part.least
    return Score(names, H, g, least)


def _direction(problem: StageProblem, kernel: Sequence[str], name: str, columns: Mapping[str, str]) -> Array:
    """Return where an effect of its usual size leads among the kernel's parameters."""
    direction = np.zeros(len(kernel))
    effect = problem.kernel.catalogue[name]
    if only_shifts(effect):
        for shift, seconds in zip(SHIFTS, problem.evidence.stage.shifts(effect), strict=True):
            direction[kernel.index(shift)] = seconds
    elif f"effects.{name}.presence" in columns:
        direction[kernel.index(f"effects.{name}.presence")] = 1.0
    return direction
