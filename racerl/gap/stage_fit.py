"""A stage's windows in the course of a fit: their initial states, and how they follow the parameters.

Every window has a free initial state; the effects' own states begin near where the measured motion puts them.
"""

import copy
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from racerl.estimation.independence import independent_residuals
from racerl.estimation.pseudo_huber import pseudo_huber
from racerl.gap.follow import lagged
from racerl.gap.normal_equations import Linear
from racerl.gap.stage_problem import StageProblem
from racerl.vehicle.rollout import Windows
from racerl.vehicle.vehicle import STATE

Array = NDArray[np.float64]
OWN_SPREAD = 0.5  # deviation of own initial states, in their spread over the windows
MEMORY_STEP = 1e-3  # of a time constant, to see how it leads own states
FIXED = 1e-6  # deviation of own initial states that the drive so far tells
WAYS = (0.1, 1.0, 10.0)  # other dampings of initial states' steps
SETTLING, ENOUGH = 4, 0.01  # most steps of initial states alone; share of its cost that one of them must take


class StageFit:
    """A stage's windows in the course of a fit."""

    def __init__(
        self, problem: StageProblem, theta: Mapping[str, float], index: NDArray[np.int64] | None, strength: float = 1.0
    ) -> None:
        """`strength`: λ of the stage, by which effects' own states are held to where the motion puts them, too."""
        self.problem, self.index, self._strength = problem, index, strength
        self.windows = self._cut(theta)
        self.initial = self.windows.initial.copy()
        if set(problem.vehicle.states) & set(problem.rollout.vehicle.states) - set(STATE):
            self._followed = (problem.at(theta) if problem.names else problem).own_states
            self.initial[len(STATE) :] = self._starts(self._followed)
        states = problem.rollout.vehicle.states
        self.columns, self.silent = problem.columns(), problem.silent()
        active = [name for name in problem.rollout.active if problem.has(name)]
        self.rows = [states.index(name) for name in active]
        used = [i for i in self.columns if i < len(problem.rollout.names)]
        self.mixing = problem.mixing[used]
        self.remembers = any(name not in STATE for name in active)  # which side of a play, say: steps may lead astray
        self._shifts = problem.shifts(theta)
        self.rest = self.initial[self.rows]
        self._began = dict(theta)
        self.usual = 0.0  # cost of a window, where the fit began
        self.precision = np.array([self._precision(states[row], self.initial[row]) for row in self.rows])

    def _cut(self, theta: Mapping[str, float]) -> Windows:
        windows = self.problem.windows(theta)
        return windows if self.index is None else windows.take(self.index)

    def _shift(self, theta: Mapping[str, float]) -> None:
        shifts = self.problem.shifts(theta)
        if shifts != self._shifts:
            self.windows, self._shifts = self._cut(theta), shifts

    def _precision(self, name: str, row: Array) -> float:
        """Return 1/s_0² of an initial state: how precisely the log has it."""
        if name in STATE:
            return self.problem.evidence.trust(name)
        effect, _, state = name.partition(".")
        told = state in self.problem.vehicle.effects[effect].told
        spread = FIXED if told else OWN_SPREAD * float(np.std(row)) + 1e-4
        return self._strength * spread**-2

    def take(self, theta: Mapping[str, float], initial: Array) -> None:
        """Start from states found before; from own ones, nan where unknown, if they fit better than the log so far."""
        self.initial[: len(STATE)] = initial[: len(STATE)]
        if self.remembers:
            self.begin(theta, self.initial, np.where(np.isnan(initial), self.initial, initial))

    def linearise(self, theta: Mapping[str, float]) -> Linear:
        """Return cost, H and g of every window."""
        windows, slope = self._now(theta), self.drift(theta)[1]
        with np.errstate(all="ignore"):
            parts = self.problem.rollout.accumulate(
                self.problem.parameters(theta), windows, columns=self.columns, silent=self.silent
            )
        M = self.mixing
        with np.errstate(invalid="ignore"):  # windows that blow up make the cost infinite
            raw = Linear.of(parts, len(M), self.problem.evidence).mixed(M)
            if self.problem.memory:
                raw = raw.with_remembered(slope)
        away = self._away()
        cost = raw.cost + (away**2 * self.precision).sum(axis=1)
        if not np.isfinite(parts.H).all():
            cost = np.full_like(cost, np.inf)
        self.usual = self.usual or raw.usual
        return replace(
            raw, cost=cost, usual=self.usual, xx=raw.xx + np.diag(self.precision), x=raw.x + away * self.precision
        )

    def _away(self) -> Array:
        """Return how far initial states are from where the measured motion puts them, (W, A)."""
        return (self.initial[self.rows] - self.rest).T

    def drift(self, theta: Mapping[str, float]) -> tuple[Array, Array]:
        """Return how far parameters have moved remembered states from where they began (S, W), and its slope by θ.

        Plain zeros where nothing is remembered.
        """
        if not self.problem.memory:
            return np.zeros(()), np.zeros(())
        drift = np.zeros_like(self.initial)
        slope = np.zeros((self.initial.shape[1], len(self.rows), len(self.problem.names)))
        for row, name in self.problem.memory.items():
            followed, now = self._followed[row - len(STATE)], theta[name]
            at, beyond = (
                self._starts(lagged(followed, self.problem.evidence, self._began[name], time))
                for time in (now, now * (1.0 + MEMORY_STEP))
            )
            drift[row] = at - self._starts(followed)
            slope[:, self.rows.index(row), self.problem.names.index(name)] = (beyond - at) / (now * MEMORY_STEP)
        return drift, slope

    def _starts(self, rows: Array) -> Array:
        """Return what rows of the log (…, R) are where windows start, (…, W)."""
        starts: Array = rows[..., self.problem.evidence.start]
        return starts if self.index is None else starts[..., self.index]

    def spread(self, line: Linear, moved: Array, damping: float) -> Array:
        """Return the step of the full initial states (S, W) when θ moves by `moved`."""
        step = np.zeros_like(self.initial)
        step[self.rows] = line.follow(moved, damping)
        return step

    def move(
        self, theta: Mapping[str, float], line: Linear, moved: Array, damping: float, *, wait: bool = False
    ) -> Array:
        """Take the initial states' step when θ moves by `moved`; return the cost per window (W,) there.

        Where own states make the way rough, or where asked to `wait`, a window whose cost does not fall stays where it
        was if that costs less at the new θ; on a rough way one that stays tries other dampings, too.
        """
        kept, ways = self.initial, WAYS if self.remembers else ()
        first, *others = (kept + self.spread(line, moved, each) for each in (damping, *ways))
        self.initial = first
        cost = self.cost(theta)
        if self.remembers or wait:
            self._take_lower(theta, cost, ~(cost < line.cost) | ~np.isfinite(line.cost), kept)
            self._take_lower(theta, cost, (self.initial == kept).all(axis=0), *others)
        return cost

    def _take_lower(self, theta: Mapping[str, float], cost: Array, among: NDArray[np.bool_], *initials: Array) -> None:
        """Start each of the windows `among` from other initial states (S, W) if they cost less; update `cost` (W,)."""
        chosen = np.flatnonzero(among)
        if not len(chosen) or not initials:
            return
        part = self.some(chosen)
        for initial in initials:
            part.initial = initial[:, chosen]
            there = part.cost(theta)
            lower = there < cost[chosen]
            cost[chosen[lower]], self.initial[:, chosen[lower]] = there[lower], part.initial[:, lower]

    def some(self, chosen: NDArray[np.int64]) -> "StageFit":
        """Return the work on some of the windows."""
        part = copy.copy(self)
        part.index = chosen if self.index is None else self.index[chosen]
        part.windows, part.initial, part.rest = self.windows.take(chosen), self.initial[:, chosen], self.rest[:, chosen]
        return part

    def begin(self, theta: Mapping[str, float], *initials: Array) -> Array:
        """Start every window from the initial state that fits it best; return the cost per window (W,)."""
        first, *others = initials
        self.initial = first.copy()
        cost = self.cost(theta)
        self._take_lower(theta, cost, np.ones(len(cost), bool), *others)
        return cost

    def settled(self) -> Array:
        """Return the cost per window once every initial state has taken its own steps, as long as they help."""
        for _ in range(SETTLING):
            line = self.linearise({})
            cost = self.move({}, line, np.zeros(0), 0.0, wait=True)
            if not (cost < (1.0 - ENOUGH) * line.cost).any():
                break
        return cost

    def strength(self, theta: Mapping[str, float], line: Linear) -> float:
        """Return λ = max(1, F_data/N_independent) of the windows as they are."""
        if not np.isfinite(line.cost).all():
            return 1.0
        errors = self.errors(theta) / self.problem.sigma[:, None] * line.weight**0.5
        return max(1.0, line.loss / independent_residuals(errors))

    def errors(self, theta: Mapping[str, float]) -> Array:
        """Return simulated − measured (T + 1, C, W) from the initial states as they are."""
        windows, parameters = self._now(theta), self.problem.parameters(theta)
        return self.problem.rollout.predict(parameters, windows) - windows.measured

    def losses(self, cost: Array) -> float:
        """Return the summed loss of windows that cost this (W,), n as where the fit began; infinite if one blew up."""
        with np.errstate(all="ignore"):
            return float(pseudo_huber(cost, self.usual).sum())

    def cost(self, theta: Mapping[str, float]) -> Array:
        """Return the cost per window (W,), as the initial states are; infinite where it blows up."""
        windows, parameters = self._now(theta), self.problem.parameters(theta)
        with np.errstate(all="ignore"):
            squares = self.problem.rollout.squares(parameters, windows).sum(axis=1)
            cost = np.asarray(squares + (self._away() ** 2 * self.precision).sum(axis=1))
        return np.where(np.isnan(cost), np.inf, cost)

    def _now(self, theta: Mapping[str, float]) -> Windows:
        """Return the windows with inputs at θ's shifts, from the initial states as they are."""
        self._shift(theta)
        return replace(self.windows, initial=self.initial + self.drift(theta)[0])
