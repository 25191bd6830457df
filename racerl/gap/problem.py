"""What a fit of the gap workflow minimises: squared errors over the noise, summed over stages that share parameters.

    F(θ, x_0) = Σ_stages Σ_c,t ((y − m)/σ_c)² + Σ ((θ − θ_0)/s)² + Σ_own ((x_0 − x̄_0)/s_0)²

Every window has a free initial state x_0; the effects' own states begin near where the measured motion puts them.
Levenberg–Marquardt on the normal equations, initial states eliminated window by window.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from racerl.gap.evidence import Evidence
from racerl.gap.follow import follow
from racerl.gap.presence import inner, only_shifts, with_all
from racerl.gap.stage import SHIFTS, StageEquations, StageRollout
from racerl.vehicle.effects import Effect
from racerl.vehicle.parameter import replace_values, specifications, values
from racerl.vehicle.rollout import Windows
from racerl.vehicle.vehicle import STATE, Vehicle

Array = NDArray[np.float64]
OWN_SPREAD = 0.5  # deviation of own initial states, in their spread over the windows
FIXED = 1e-6  # deviation of states that are known, such as clocks
WORST = 1e8  # damping at which no step helps any more


@dataclass(frozen=True)
class Unknown:
    """One parameter of a fit, with its prior and bounds."""

    name: str
    start: float
    sigma: float
    low: float
    high: float


class StageKernel:
    """One stage of a vehicle with every effect of a catalogue in it, compiled once for any set of them."""

    def __init__(
        self, evidence: Evidence, vehicle: Vehicle, free: Sequence[str], catalogue: Mapping[str, Effect]
    ) -> None:
        everything = evidence.stage.vehicle(with_all(vehicle, catalogue))
        table = values(everything)
        inside = [name for name in table if name in free or ".effect." in name]
        presences = [name for name in table if name.endswith(".presence")]
        inside = StageEquations(everything, [*inside, *presences], evidence.observed).effective()
        # what is zero is left out of the kernel, except in effects; anything else may differ from car to car
        given = [name for name, v in table.items() if name not in inside and (float(v) != 0.0 or "effects." in name)]
        self.rollout = StageRollout(everything, [*inside, *SHIFTS], evidence.observed, given=given)
        self.catalogue = catalogue


class StageKernels:
    """The kernels of a stage: one for effects that leave it apart from the other stages, one for all effects."""

    def __init__(
        self, evidence: Evidence, vehicle: Vehicle, free: Sequence[str], catalogue: Mapping[str, Effect]
    ) -> None:
        self._make = lambda effects: StageKernel(evidence, vehicle, free, effects)
        alone = StageEquations(evidence.stage.vehicle(vehicle), [], evidence.observed).active
        self.coupling = {
            name
            for name, effect in catalogue.items()
            if not only_shifts(effect) and set(_active(evidence, vehicle, {name: effect})) & set(STATE) - set(alone)
        }
        self.catalogue = catalogue
        self._apart = self._make({name: e for name, e in catalogue.items() if name not in self.coupling})
        self._all: StageKernel | None = None

    def choose(self, vehicle: Vehicle) -> StageKernel:
        """Return the kernel that has all the vehicle's effects in it."""
        if not self.coupling & set(vehicle.effects):
            return self._apart
        if self._all is None:
            self._all = self._make(self.catalogue)
        return self._all


def _active(evidence: Evidence, vehicle: Vehicle, effects: Mapping[str, Effect]) -> list[str]:
    car = evidence.stage.vehicle(replace(vehicle, effects={**vehicle.effects, **effects}))
    return StageEquations(car, [], evidence.observed).active


@dataclass(frozen=True)
class StageProblem:
    """One stage's share of a fit: θ's names that it depends on, its kernel and its windows' noise."""

    evidence: Evidence
    kernel: StageKernel
    vehicle: Vehicle
    names: tuple[str, ...]  # of θ, in this stage
    sigma: Array  # (C,)
    threads: int

    @classmethod
    def of(
        cls,
        evidence: Evidence,
        kernels: StageKernels,
        vehicle: Vehicle,
        unknowns: Sequence[Unknown],
        sigma: Array,
        threads: int,
    ) -> "StageProblem":
        """Choose the unknowns that matter to the stage."""
        kernel = kernels.choose(vehicle)
        matter = [u.name for u in unknowns if _matters(evidence, kernel, vehicle, u.name)]
        return cls(evidence, kernel, vehicle, tuple(matter), sigma, threads)

    @staticmethod
    def touched(evidence: Evidence, kernels: StageKernels, vehicle: Vehicle, unknowns: Sequence[Unknown]) -> bool:
        """Return whether the stage's outcome depends on any of the unknowns."""
        kernel = kernels.choose(vehicle)
        return any(_matters(evidence, kernel, vehicle, unknown.name) for unknown in unknowns)

    @property
    def rollout(self) -> StageRollout:
        """Return the kernel's rollout."""
        return self.kernel.rollout

    def columns(self) -> list[int]:
        """Return the kernel's unknowns that are needed: parameters, shifts, and initial states that are heard."""
        names = self.rollout.names
        asked = [i for i, share in enumerate(np.abs(self.mixing()).sum(axis=1)) if share > 0.0]
        return asked + [len(names) + i for i, state in enumerate(self.rollout.active) if self.heard(state)]

    def heard(self, state: str) -> bool:
        """Return whether a state is the car's own, or one of an effect that is present."""
        return state in STATE or state.split(".")[0] in self.vehicle.effects

    def shifts(self, theta: Mapping[str, float]) -> tuple[float, float]:
        """Return the shifts of both inputs, in s."""
        car = _with(self.vehicle, theta)
        total = np.sum([self.evidence.stage.shifts(effect) for effect in car.effects.values()] or [(0.0, 0.0)], axis=0)
        return float(total[0]), float(total[1])

    def mixing(self) -> Array:
        """Return ∂(kernel parameters)/∂(names), (P, N)."""
        kernel = self.rollout.names
        matrix = np.zeros((len(kernel), len(self.names)))
        for column, name in enumerate(self.names):
            if inner(name) in kernel:
                matrix[kernel.index(inner(name)), column] = 1.0
            else:
                for shift, share in zip(SHIFTS, _shift_of(self.evidence, self.vehicle, name), strict=True):
                    matrix[kernel.index(shift), column] = share
        return matrix

    def parameters(self, theta: Mapping[str, float]) -> Array:
        """Return the kernel's parameters; its shifts are zero, since the inputs are shifted already."""
        table = values(self.everything(theta))
        return np.array([0.0 if n in SHIFTS else float(table[n]) for n in [*self.rollout.names, *self.rollout.given]])

    def everything(self, theta: Mapping[str, float]) -> Vehicle:
        """Return the kernel's vehicle with θ's values."""
        return self.evidence.stage.vehicle(with_all(_with(self.vehicle, theta), self.kernel.catalogue))

    def windows(self, theta: Mapping[str, float]) -> Windows:
        """Return the windows with inputs at θ's shifts and own states settled in the measured motion."""
        windows = self.evidence.windows(self.rollout.vehicle.states, self.shifts(theta))
        return replace(windows, weight=np.repeat(1.0 / self.sigma[:, None], windows.initial.shape[1], axis=1))

    def own_states(self, theta: Mapping[str, float]) -> Array:
        """Return the effects' own states (S − 8, W) at the windows' starts, led there by the measured motion."""
        car = self.evidence.stage.vehicle(_with(self.vehicle, theta))
        heard = dict(zip(car.states[len(STATE) :], follow(car, self.evidence)[:, self.evidence.start], strict=True))
        silent = np.zeros(len(self.evidence.start))
        return np.array([heard.get(name, silent) for name in self.rollout.vehicle.states[len(STATE) :]])


def _with(vehicle: Vehicle, theta: Mapping[str, float]) -> Vehicle:
    known = values(vehicle)
    return replace_values(vehicle, {name: value for name, value in theta.items() if name in known})


def _matters(evidence: Evidence, kernel: StageKernel, vehicle: Vehicle, name: str) -> bool:
    return inner(name) in kernel.rollout.names or _shift_of(evidence, vehicle, name) != (0.0, 0.0)


def _shift_of(evidence: Evidence, vehicle: Vehicle, name: str) -> tuple[float, float]:
    """Return by how much one second of a parameter shifts the stage's inputs."""
    if not name.startswith("effects."):
        return 0.0, 0.0
    key = name.split(".")[1]
    if not only_shifts(vehicle.effects[key]):
        return 0.0, 0.0
    up, none = (_with(vehicle, {name: size}).effects[key] for size in (1.0, 0.0))
    at_one, at_none = evidence.stage.shifts(up), evidence.stage.shifts(none)
    return at_one[0] - at_none[0], at_one[1] - at_none[1]


@dataclass(frozen=True)
class Linear:
    """A stage at a point: cost per window, and H, g over (θ, x_0) of each window."""

    cost: Array
    H: Array
    g: Array


@dataclass
class Fit:
    """Parameters and initial states found; `cost` per stage and window, priors of θ apart."""

    theta: dict[str, float]
    initial: list[Array]
    cost: list[Array]
    total: float
    H: Array
    converged: bool


class Problem:
    """A fit over several stages."""

    def __init__(self, stages: Sequence[StageProblem], unknowns: Sequence[Unknown]) -> None:
        used = {name for stage in stages for name in stage.names}
        self.stages = list(stages)
        self.unknowns = [unknown for unknown in unknowns if unknown.name in used]
        self.names = [unknown.name for unknown in self.unknowns]
        self.scale = np.array([unknown.sigma for unknown in self.unknowns])
        self.low = np.array([unknown.low for unknown in self.unknowns])
        self.high = np.array([unknown.high for unknown in self.unknowns])
        self.mean = np.array([unknown.start for unknown in self.unknowns])

    def fit(
        self,
        theta: Mapping[str, float],
        initial: Sequence[Array] | None = None,
        index: Sequence[NDArray[np.int64]] | None = None,
        iterations: int = 8,
        tolerance: float = 2e-5,
        hold: bool = False,
    ) -> Fit:
        """Minimise F over some windows of each stage (all unless given); with `hold` over x_0 only."""
        work = [_Work(stage, theta, None if index is None else index[i]) for i, stage in enumerate(self.stages)]
        for i, stage in enumerate(work):
            if initial is not None:
                stage.take(initial[i])
        vector = np.array([theta[name] for name in self.names])
        at = self._evaluate(work, vector)
        damping, converged = 1e-3, False
        for _ in range(iterations):
            while True:
                trial, moves = self._step(work, at, vector, damping, hold)
                before = [stage.initial for stage in work]
                for stage, move in zip(work, moves, strict=True):
                    stage.initial = stage.initial + move
                there = self._evaluate(work, trial)
                if there[0] <= at[0]:
                    break
                for stage, kept in zip(work, before, strict=True):
                    stage.initial = kept
                damping *= 8.0
                if damping > WORST:
                    return self._result(work, vector, at, True)
            gain = (at[0] - there[0]) / max(at[0], 1e-300)
            vector, at, damping = trial, there, max(damping / 8.0, 1e-7)
            if gain < tolerance:
                converged = True
                break
        return self._result(work, vector, at, converged)

    def _evaluate(self, work: Sequence["_Work"], vector: Array) -> tuple[float, list[Linear]]:
        theta = dict(zip(self.names, vector.tolist(), strict=True))
        lines = [stage.linearise(theta) for stage in work]
        total = sum(float(line.cost.sum()) for line in lines)
        total += float((((vector - self.mean) / self.scale) ** 2).sum())
        return (total if np.isfinite(total) else np.inf), lines

    def _reduced(self, work: Sequence["_Work"], lines: Sequence[Linear], damping: float) -> tuple[Array, Array]:
        """Return H and g over θ with initial states eliminated, and the priors in."""
        size = len(self.names)
        H, g = np.zeros((size, size)), np.zeros(size)
        for stage, line in zip(work, lines, strict=True):
            place = [self.names.index(name) for name in stage.problem.names]
            N = len(place)
            gain = line.H[:, :N, N:] @ stage.inverse(line, damping)
            part = (line.H[:, :N, :N] - gain @ line.H[:, N:, :N]).sum(axis=0)
            H[np.ix_(place, place)] += part
            g[place] += (line.g[:, :N] - np.einsum("wnx,wx->wn", gain, line.g[:, N:])).sum(axis=0)
        return H, g

    def _step(
        self, work: Sequence["_Work"], at: tuple[float, list[Linear]], vector: Array, damping: float, hold: bool
    ) -> tuple[Array, list[Array]]:
        """Return θ after a damped step inside the bounds, and what each stage's initial states move by."""
        trial = vector
        if not hold and len(vector):
            H, g = self._reduced(work, at[1], damping)
            A = H * np.outer(self.scale, self.scale) + np.eye(len(g))
            b = g * self.scale + (vector - self.mean) / self.scale
            A += damping * np.diag(np.diag(A))
            free = ~(((vector <= self.low) & (b > 0)) | ((vector >= self.high) & (b < 0)))
            step = np.zeros_like(b)
            step[free] = -np.linalg.solve(A[np.ix_(free, free)], b[free])
            trial = np.clip(vector + step * self.scale, self.low, self.high)
        moves = []
        for stage, line in zip(work, at[1], strict=True):
            moved = np.array([trial[self.names.index(n)] - vector[self.names.index(n)] for n in stage.problem.names])
            moves.append(stage.follow(line, moved, damping))
        return trial, moves

    def _result(self, work: Sequence["_Work"], vector: Array, at: tuple[float, list[Linear]], converged: bool) -> Fit:
        H, _ = self._reduced(work, at[1], 0.0)
        return Fit(
            dict(zip(self.names, vector.tolist(), strict=True)),
            [stage.initial for stage in work],
            [line.cost for line in at[1]],
            at[0],
            H,
            converged,
        )


class _Work:
    """A stage's windows in the course of a fit."""

    def __init__(self, problem: StageProblem, theta: Mapping[str, float], index: NDArray[np.int64] | None) -> None:
        self.problem, self.index = problem, index
        self.windows = self._cut(theta)
        self.initial = self.windows.initial.copy()
        if problem.vehicle.states != STATE:
            own = problem.own_states(theta)
            self.initial[len(STATE) :] = own if index is None else own[:, index]
        states = problem.rollout.vehicle.states
        self.columns = problem.columns()
        active = [name for name in problem.rollout.active if problem.heard(name)]
        self.rows = [states.index(name) for name in active]
        used = [i for i in self.columns if i < len(problem.rollout.names)]
        self.mixing = problem.mixing()[used]
        self._shifts = problem.shifts(theta)
        self.rest = self.initial[self.rows]
        self.precision = np.array([self._precision(states[row], self.initial[row]) for row in self.rows])

    def _cut(self, theta: Mapping[str, float]) -> Windows:
        windows = self.problem.windows(theta)
        return windows if self.index is None else windows.take(self.index)

    def _precision(self, name: str, row: Array) -> float:
        """Return 1/s_0² of an initial state; zero for the car's own."""
        if name in STATE:
            return self.problem.evidence.trust(name)
        spread = FIXED if name.endswith((".clock", ".heat")) else OWN_SPREAD * float(np.std(row)) + 1e-4
        return spread**-2

    def take(self, initial: Array) -> None:
        """Start from initial states of the car that were found before."""
        self.initial[: len(STATE)] = initial[: len(STATE)]

    def linearise(self, theta: Mapping[str, float]) -> Linear:
        """Return cost, H and g of every window."""
        shifts = self.problem.shifts(theta)
        if shifts != self._shifts:
            self.windows, self._shifts = self._cut(theta), shifts
        windows = replace(self.windows, initial=self.initial)
        with np.errstate(all="ignore"):
            parts = self.problem.rollout.accumulate(
                self.problem.parameters(theta), windows, self.problem.threads, self.columns
            )
        P, M = len(self.mixing), self.mixing
        away = (self.initial[self.rows] - self.rest).T  # (W, A)
        H = np.concatenate(
            [
                np.concatenate([M.T @ parts.H[:, :P, :P] @ M, M.T @ parts.H[:, :P, P:]], axis=2),
                np.concatenate([parts.H[:, P:, :P] @ M, parts.H[:, P:, P:] + np.diag(self.precision)], axis=2),
            ],
            axis=1,
        )
        g = np.concatenate([parts.g[:, :P] @ M, parts.g[:, P:] + away * self.precision], axis=1)
        cost = parts.squares.sum(axis=1) + (away**2 * self.precision).sum(axis=1)
        if not np.isfinite(H).all():
            cost = np.full_like(cost, np.inf)
        return Linear(cost, H, g)

    def inverse(self, line: Linear, damping: float) -> Array:
        """Return the damped inverse of H over x_0, (W, A, A)."""
        N = len(self.problem.names)
        xx = line.H[:, N:, N:]
        diagonal = np.einsum("waa->wa", xx)
        ridge = damping * diagonal + 1e-10 * diagonal.max(axis=1, keepdims=True) + 1e-300
        return np.linalg.inv(xx + ridge[:, :, None] * np.eye(xx.shape[1]))

    def follow(self, line: Linear, moved: Array, damping: float) -> Array:
        """Return the initial states' own step (S, W) when θ moves by `moved`."""
        N = len(self.problem.names)
        gradient = line.g[:, N:] + line.H[:, N:, :N] @ moved
        step = np.zeros_like(self.initial)
        step[self.rows] = -np.einsum("wxy,wy->xw", self.inverse(line, damping), gradient)
        return step


@dataclass(frozen=True)
class Score:
    """What first-order theory says of adding effects at their usual sizes: H and g over their presences."""

    names: list[str]
    H: Array
    g: Array

    def gains(self) -> dict[str, float]:
        """Return by how much the cost would fall with each effect alone, at its best size of either sign."""
        stiffness = np.maximum(np.diag(self.H), 1e-12)
        return dict(zip(self.names, (self.g**2 / stiffness).tolist(), strict=True))

    def cosines(self) -> Array:
        """Return how alike effects look in this data, (E, E): ± 1 cannot be told apart."""
        size = np.sqrt(np.maximum(np.diag(self.H), 1e-12))
        cosine: Array = self.H / np.outer(size, size)
        return cosine


def score(problem: StageProblem, theta: Mapping[str, float], initial: Array) -> Score:
    """Return the score of all effects that the kernel knows and the vehicle lacks.

    The sensitivities to the nominal parameters and to every window's initial state are projected out: what they can
    explain does not count for an effect.
    """
    rollout, size = problem.rollout, len(problem.rollout.names)
    car = problem.everything(theta)
    absent = [name for name in problem.kernel.catalogue if name not in problem.vehicle.effects]
    columns = {f"effects.{name}.presence": name for name in absent if f"effects.{name}.presence" in rollout.names}
    windows = replace(problem.windows(theta), initial=initial.copy())
    windows.initial[len(STATE) :] = follow(car, problem.evidence)[:, problem.evidence.start]
    heard = [size + i for i, name in enumerate(rollout.active) if problem.heard(name)]
    asked = [*range(size), *heard]
    parts = rollout.accumulate(problem.parameters(theta), windows, problem.threads, asked)
    trust = np.array([problem.evidence.trust(rollout.active[i - size]) for i in heard])
    xx = parts.H[:, size:, size:] + np.diag(trust)
    scale = 1e-10 * np.einsum("waa->wa", xx).max(axis=1)
    gain = parts.H[:, :size, size:] @ np.linalg.inv(xx + scale[:, None, None] * np.eye(len(heard)))
    H = (parts.H[:, :size, :size] - gain @ parts.H[:, size:, :size]).sum(axis=0)
    g = (parts.g[:, :size] - np.einsum("wpx,wx->wp", gain, parts.g[:, size:])).sum(axis=0)
    nominal = problem.mixing()
    spread = nominal.T @ H @ nominal
    spread += 1e-9 * np.diag(np.diag(spread)) + 1e-12 * np.eye(len(spread))
    picked = np.zeros((size, len(absent)))
    for k, name in enumerate(absent):
        picked[:, k] = _direction(problem, rollout.names, name, columns)
    away = picked - nominal @ np.linalg.solve(spread, nominal.T @ H @ picked)
    return Score(absent, away.T @ H @ away, away.T @ g)


def merged(one: Score, other: Score) -> Score:
    """Return the sum of two stages' scores, over the effects of either."""
    names = [*one.names, *(name for name in other.names if name not in one.names)]
    H, g = np.zeros((len(names), len(names))), np.zeros(len(names))
    for part in (one, other):
        place = [names.index(name) for name in part.names]
        H[np.ix_(place, place)] += part.H
        g[place] += part.g
    return Score(names, H, g)


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


def unknowns_of(vehicle: Vehicle, sigma: Mapping[str, float]) -> list[Unknown]:
    """Return the parameters that `sigma` frees, at the vehicle's values and bounds."""
    known, table = specifications(vehicle), values(vehicle)
    return [
        Unknown(name, float(table[name]), width, known[name].low, known[name].high)
        for name, width in sigma.items()
        if name in table
    ]
