"""What a fit of the gap workflow minimises: squared errors over the noise, summed over stages that share parameters.

    F(θ, x_0) = Σ_stages Σ_windows ρ(c) + Σ λ ((θ − θ_0)/s)²
    c = Σ_c,t ((y − m)/σ_c)² + Σ_own ((x_0 − x̄_0)/s_0)²,    ρ(c) = 2√2 n (√(1 + c/n) − 1)

Every window has a free initial state x_0; the effects' own states begin near where the measured motion puts them. With
n the cost of a usual window, ρ (Charbonnier's) counts such windows by their cost and those that no vehicle foresees, a
spin, by its root: they do not decide alone. Where the model leaves more than noise, N numbers that hang together are
worth fewer: λ = max(1, F_data/N_independent) of a stage makes the priors of the vehicle's parameters in it as strong
as they should be beside such data. Levenberg–Marquardt on the normal equations with windows weighted by ρ'(c), initial
states eliminated window by window.
"""

import copy
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from racerl.estimation.independence import independent_residuals
from racerl.estimation.levenberg_marquardt import WORST, bounded_step, descend
from racerl.estimation.schur import WindowEquations
from racerl.gap.evidence import Evidence
from racerl.gap.follow import follow, lagged
from racerl.gap.kernels import StageKernel, StageKernels
from racerl.gap.presence import inner, only_shifts, with_all
from racerl.gap.stage import SHIFTS, StageRollout
from racerl.vehicle.parameter import replace_values, values
from racerl.vehicle.rollout import NormalEquations, Windows
from racerl.vehicle.vehicle import STATE, Vehicle

Array = NDArray[np.float64]
OWN_SPREAD = 0.5  # deviation of own initial states, in their spread over the windows
MEMORY_STEP = 1e-3  # of a time constant, to see how it leads own states
FIXED = 1e-6  # deviation of own initial states that the drive so far tells
WAYS = (0.1, 1.0, 10.0)  # other dampings of initial states' steps
SETTLING, ENOUGH = 4, 0.01  # most steps of initial states alone; share of its cost that one of them must take
HELD_DAMPING = 1e-2  # of the step to a fold's parameters, at first
SPOILT = 1.02  # times the cost of the windows that a step was made from, above which it went too far


@dataclass(frozen=True)
class Unknown:
    """One parameter of a fit, with its prior and bounds."""

    name: str
    start: float
    sigma: float
    low: float
    high: float
    effect: bool = False  # of an effect: its prior is wide, and stays as it is whatever the model leaves


@dataclass(frozen=True)
class StageProblem:
    """One stage's share of a fit: θ's names that it depends on, its kernel and its windows' noise."""

    evidence: Evidence
    kernel: StageKernel
    vehicle: Vehicle
    names: tuple[str, ...]  # of θ, in this stage
    sigma: Array  # (C,)

    @classmethod
    def of(
        cls,
        evidence: Evidence,
        kernels: StageKernels,
        vehicle: Vehicle,
        unknowns: Sequence[Unknown],
        sigma: Array,
        *,
        whole: bool = False,
    ) -> "StageProblem":
        """Choose the unknowns that matter to the stage, and its kernel; `whole`: one with the whole catalogue."""
        kernel = kernels.choose(vehicle, whole=whole)
        matter = [u.name for u in unknowns if _matters(evidence, kernel, vehicle, u.name)]
        return cls(evidence, kernel, vehicle, tuple(matter), sigma)

    @staticmethod
    def touched(evidence: Evidence, kernels: StageKernels, vehicle: Vehicle, unknowns: Sequence[Unknown]) -> bool:
        """Return whether the stage's outcome depends on any of the unknowns."""
        kernel = kernels.choose(vehicle)
        return any(_matters(evidence, kernel, vehicle, unknown.name) for unknown in unknowns)

    @property
    def rollout(self) -> StageRollout:
        """Return the kernel's rollout."""
        return self.kernel.rollout

    def told(self) -> list[Any]:
        """Return all that a fit of these windows comes from, but for where it starts."""
        table = {name: float(value) for name, value in values(self.vehicle).items()}
        of_effects = [list(self.vehicle.effects), list(self.kernel.catalogue), self.rollout.names]
        return [self.evidence.stage.name, self.evidence.early, self.names, self.sigma, table, of_effects]

    def columns(self) -> list[int]:
        """Return the kernel's unknowns that are needed: parameters, shifts, and initial states that act."""
        names = self.rollout.names
        asked = [i for i, share in enumerate(np.abs(self.mixing).sum(axis=1)) if share > 0.0]
        return asked + [len(names) + i for i, state in enumerate(self.rollout.active) if self.has(state)]

    def has(self, state: str) -> bool:
        """Return whether a state is the car's own, or one of an effect that is present."""
        return state in STATE or state.split(".")[0] in self.vehicle.effects

    def silent(self) -> set[str]:
        """Return the states of effects that are absent."""
        return {state for state in self.rollout.active if not self.has(state)}

    @cached_property
    def memory(self) -> dict[int, str]:
        """Return the time constants, among the unknowns, of own states that remember more than a window, by row."""
        return {
            row: name
            for row, state in enumerate(self.rollout.vehicle.states)
            for name in self.names
            if row >= len(STATE) and self.has(state) and _remembered(self.vehicle, state, name)
        }

    def shifts(self, theta: Mapping[str, float]) -> tuple[float, float]:
        """Return the shifts of both inputs, in s."""
        late = any(only_shifts(effect) for effect in self.vehicle.effects.values())
        first, second = self.evidence.stage.shifts(_with(self.vehicle, theta) if late else self.vehicle)
        return float(first), float(second)

    @cached_property
    def mixing(self) -> Array:
        """∂(kernel parameters)/∂(names), (P, N)."""
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
        place, found = self._parameters
        found = found.copy()
        for name, value in theta.items():
            if inner(name) in place:
                found[place[inner(name)]] = value
        return found

    @cached_property
    def _parameters(self) -> tuple[dict[str, int], Array]:
        """The places of the kernel's parameters, and what they are in the vehicle as it is."""
        names, table = [*self.rollout.names, *self.rollout.given], values(self.everything({}))
        return {name: i for i, name in enumerate(names)}, np.array([float(table.get(name, 0.0)) for name in names])

    def everything(self, theta: Mapping[str, float]) -> Vehicle:
        """Return the kernel's vehicle with θ's values."""
        return self.evidence.stage.vehicle(with_all(_with(self.vehicle, theta), self.kernel.catalogue))

    def windows(self, theta: Mapping[str, float]) -> Windows:
        """Return the windows with inputs at θ's shifts, weighted by the noise."""
        windows = self.evidence.windows(self.rollout.vehicle.states, self.shifts(theta))
        return replace(windows, weight=np.repeat(1.0 / self.sigma[:, None], windows.initial.shape[1], axis=1))

    def errors(self, theta: Mapping[str, float], initial: Array) -> Array:
        """Return simulated − measured (T + 1, C, W)."""
        windows = replace(self.windows(theta), initial=initial)
        return self.rollout.predict(self.parameters(theta), windows) - windows.measured

    def at(self, theta: Mapping[str, float]) -> "StageProblem":
        """Return the stage's share at θ, of which nothing varies."""
        return replace(self, names=(), vehicle=_with(self.vehicle, theta))

    @cached_property
    def own_states(self) -> Array:
        """The effects' own states along the log (S − 8, R), led by the measured motion."""
        car = self.evidence.stage.vehicle(self.vehicle)
        followed = dict(zip(car.states[len(STATE) :], follow(car, self.evidence), strict=True))
        silent = np.zeros(len(self.evidence.first))
        return np.array([followed.get(name, silent) for name in self.rollout.vehicle.states[len(STATE) :]])


def _with(vehicle: Vehicle, theta: Mapping[str, float]) -> Vehicle:
    known = values(vehicle)
    return replace_values(vehicle, {name: value for name, value in theta.items() if name in known})


def _remembered(vehicle: Vehicle, state: str, name: str) -> bool:
    effect = state.split(".")[0]
    return name.startswith(f"effects.{effect}.") and name.rpartition(".")[2] in vehicle.effects[effect].memory


def _matters(evidence: Evidence, kernel: StageKernel, vehicle: Vehicle, name: str) -> bool:
    return inner(name) in kernel.rollout.names or _shift_of(evidence, vehicle, name) != (0.0, 0.0)


def _shift_of(evidence: Evidence, vehicle: Vehicle, name: str) -> tuple[float, float]:
    """Return by how much one second of a parameter shifts the stage's inputs."""
    if not name.startswith("effects."):
        return 0.0, 0.0
    if not only_shifts(vehicle.effects[name.split(".")[1]]):
        return 0.0, 0.0
    up, none = (_with(vehicle, {name: size}) for size in (1.0, 0.0))
    at_one, at_none = evidence.stage.shifts(up), evidence.stage.shifts(none)
    return at_one[0] - at_none[0], at_one[1] - at_none[1]


@dataclass(frozen=True)
class Linear(WindowEquations):
    """A stage at a point: cost per window (W,), n of ρ, and the normal equations of each window's (θ, x_0)."""

    cost: Array
    usual: float

    @classmethod
    def of(cls, parts: NormalEquations, size: int, evidence: Evidence) -> "Linear":
        """Split normal equations after their first `size` unknowns."""
        H, g, cost = parts.H, parts.g, parts.squares.sum(axis=1)
        tt, tx, xx = H[:, :size, :size], H[:, :size, size:], H[:, size:, size:]
        return cls(tt, tx, xx, g[:, :size], g[:, size:], cost, usual_cost(evidence, cost))

    @property
    def loss(self) -> float:
        """Summed loss of the windows."""
        return float(loss(self.cost, self.usual).sum())

    @property
    def weight(self) -> Array:
        """ρ'(c) of the windows, (W,)."""
        return np.asarray(np.sqrt(2.0 / (1.0 + self.cost / self.usual)))

    def mixed(self, M: Array) -> "Linear":
        """Return the same over θ of which the rows' parameters are M θ."""
        return replace(self, tt=M.T @ self.tt @ M, tx=M.T @ self.tx, t=self.t @ M)

    def with_remembered(self, slope: Array) -> "Linear":
        """Return the same over θ that leads initial states, too, by `slope` (W, A, N)."""
        back = slope.transpose(0, 2, 1)
        shared = self.tx @ slope
        return replace(
            self,
            tt=self.tt + shared + shared.transpose(0, 2, 1) + back @ self.xx @ slope,
            tx=self.tx + back @ self.xx,
            t=self.t + np.einsum("wna,wa->wn", back, self.x),
        )

    def reduced(self, damping: float = 0.0) -> tuple[Array, Array]:
        """Return H (W, N, N) and g (W, N) over θ with each window's initial state eliminated, weighted by ρ'(c)."""
        H, g = super().reduced(damping)
        return self.weight[:, None, None] * H, self.weight[:, None] * g


def usual_cost(evidence: Evidence, cost: Array) -> float:
    """Return n, the cost of a stage's usual window: that of noise, or what half of the windows have and more."""
    return max(float(evidence.numbers), float(np.median(cost)))


def loss(cost: Array, usual: float) -> Array:
    """Return ρ(c) of windows' costs, n the cost of a usual window; ρ'(n) = 1."""
    found: Array = 2.0 * np.sqrt(2.0) * usual * (np.sqrt(1.0 + cost / usual) - 1.0)
    return found


@dataclass
class Fit:
    """Parameters found, and per stage initial states and cost by window, priors of θ apart."""

    theta: dict[str, float]
    initial: list[Array]
    cost: list[Array]
    strength: list[float]  # λ of every stage that its residuals ask for
    converged: bool
    linearise: Callable[[], list[Linear]]  # a fit of a checkpoint is without: few are asked for it

    @cached_property
    def lines(self) -> list[Linear]:
        """Every stage at the point found."""
        return self.linearise()

    def reduced(self) -> list[tuple[Array, Array]]:
        """Return each stage's H and g (W, …) over θ, windows weighted, with initial states eliminated."""
        return [line.reduced(0.0) for line in self.lines]

    def parts(self) -> dict[str, NDArray[Any]]:
        """Return the fit as arrays, without its derivatives."""
        stages = range(len(self.cost))
        return {
            "theta": np.array(list(self.theta.values())),
            "strength": np.array(self.strength),
            "converged": np.array([self.converged]),
            **{f"initial.{i}": self.initial[i] for i in stages},
            **{f"cost.{i}": self.cost[i] for i in stages},
        }

    @classmethod
    def of(
        cls, parts: Mapping[str, NDArray[Any]], names: Sequence[str], linearise: Callable[[], list[Linear]]
    ) -> "Fit":
        """Return the fit of which these are the parts, θ in this order."""
        initial, cost = ([parts[f"{what}.{i}"] for i in range(len(parts["strength"]))] for what in ("initial", "cost"))
        theta = dict(zip(names, parts["theta"].tolist(), strict=True))
        return cls(theta, initial, cost, parts["strength"].tolist(), bool(parts["converged"][0]), linearise)


class Problem:
    """A fit over several stages."""

    def __init__(
        self, stages: Sequence[StageProblem], unknowns: Sequence[Unknown], strength: Sequence[float] | None = None
    ) -> None:
        """`strength`: λ of every stage, one unless given."""
        used = {name for stage in stages for name in stage.names}
        self.stages = list(stages)
        self.strength = list(strength or [1.0] * len(self.stages))
        self.unknowns = [unknown for unknown in unknowns if unknown.name in used]
        self.names = [unknown.name for unknown in self.unknowns]
        self.scale = np.array([self._scale(unknown) for unknown in self.unknowns])
        self.low = np.array([unknown.low for unknown in self.unknowns])
        self.high = np.array([unknown.high for unknown in self.unknowns])
        self.mean = np.array([unknown.start for unknown in self.unknowns])

    def _scale(self, unknown: Unknown) -> float:
        """Return the deviation s/√λ of an unknown's prior."""
        seen = [λ for λ, stage in zip(self.strength, self.stages, strict=True) if unknown.name in stage.names]
        return unknown.sigma if unknown.effect else unknown.sigma / float(np.sqrt(max(seen)))

    def told(self) -> list[Any]:
        """Return all that a fit comes from, but for where it starts."""
        unknowns = [list(vars(unknown).values()) for unknown in self.unknowns]
        return [[stage.told() for stage in self.stages], unknowns, self.strength]

    def fit(
        self,
        theta: Mapping[str, float],
        initial: Sequence[Array] | None = None,
        index: Sequence[NDArray[np.int64]] | None = None,
        iterations: int = 8,
        tolerance: float = 1e-4,
    ) -> Fit:
        """Minimise F over some windows of each stage (all unless given), until it falls by less than `tolerance`."""
        work = [_Work(stage, theta, None if index is None else index[i]) for i, stage in enumerate(self.stages)]
        for i, stage in enumerate(work):
            if initial is not None:
                stage.take(theta, initial[i])
        start = np.array([theta[name] for name in self.names]), [stage.initial for stage in work]
        landscape = _Landscape(self, work)
        end = descend(landscape, start, iterations, tolerance)
        landscape.put(end.place)  # the step tried last may have been in vain
        return self._result(work, end.place[0], end.slope.lines, end.converged)

    def named(self, vector: Array) -> dict[str, float]:
        """Return θ by name."""
        return dict(zip(self.names, vector.tolist(), strict=True))

    def prior(self, vector: Array) -> float:
        """Return Σ λ ((θ − θ_0)/s)²."""
        return float((((vector - self.mean) / self.scale) ** 2).sum())

    def _total(
        self, reduced: Sequence[tuple[Array, Array]], windows: Sequence[NDArray[np.bool_]] | None = None
    ) -> tuple[Array, Array]:
        """Return H and g over θ, summed over windows, from each stage's with initial states eliminated."""
        size = len(self.names)
        H, g = np.zeros((size, size)), np.zeros(size)
        for i, (stage, (part, slope)) in enumerate(zip(self.stages, reduced, strict=True)):
            place = self.places(stage)
            chosen = slice(None) if windows is None else windows[i]
            H[np.ix_(place, place)] += part[chosen].sum(axis=0)
            g[place] += slope[chosen].sum(axis=0)
        return H, g

    def _moved(self, H: Array, g: Array, vector: Array, damping: float) -> Array:
        """Return θ after a damped step down g inside the bounds; H is without the priors, g with theirs."""
        stiffness = H * np.outer(self.scale, self.scale) + np.eye(len(g))
        return bounded_step(stiffness, g * self.scale, vector, self.low, self.high, self.scale, damping)

    def step(self, lines: Sequence[Linear], vector: Array, damping: float) -> Array:
        """Return θ after a damped step."""
        if not len(vector):
            return vector
        H, g = self._total([line.reduced(damping) for line in lines])
        return self._moved(H, g + (vector - self.mean) / self.scale**2, vector, damping)

    def places(self, stage: StageProblem) -> list[int]:
        """Return where the names of a stage stand in θ."""
        return [self.names.index(name) for name in stage.names]

    def _result(self, work: Sequence["_Work"], vector: Array, lines: list[Linear], converged: bool) -> Fit:
        theta = self.named(vector)
        initial = [stage.initial + stage.drift(theta)[0] for stage in work]
        strength = [stage.strength(theta, line) for stage, line in zip(work, lines, strict=True)]
        return Fit(theta, initial, [line.cost for line in lines], strength, converged, lambda: lines)

    def held_out(self, fit: Fit, folds: Sequence[Sequence[NDArray[np.bool_]]]) -> list[Array]:
        """Return the cost of every window (W,) per stage, under parameters that were found without its fold."""
        cost = [np.zeros_like(part) for part in fit.cost]
        for i, mask, work in self._held(fit, folds):
            cost[i][mask] = work.settled()
        return cost

    def held_out_errors(self, fit: Fit, folds: Sequence[Sequence[NDArray[np.bool_]]]) -> list[Array]:
        """Return simulated − measured (T + 1, C, W) per stage, likewise."""
        errors = [np.zeros((s.evidence.length + 1, len(s.sigma), len(s.evidence.start))) for s in self.stages]
        for i, mask, work in self._held(fit, folds):
            work.settled()
            errors[i][:, :, mask] = work.errors({})
        return errors

    def _held(
        self, fit: Fit, folds: Sequence[Sequence[NDArray[np.bool_]]]
    ) -> Iterator[tuple[int, NDArray[np.bool_], "_Work"]]:
        """Yield (stage, windows, work) of every fold under parameters that were found without it.

        `folds` are masks of the windows per stage. Parameters of a fold by the infinitesimal jackknife,
        θ − θ_f = −H_f̄⁻¹ g_f with H_f̄ of the windows outside and g_f of those inside of it, damped where the data say
        little; the initial states of its windows follow.
        """
        reduced = fit.reduced()
        for fold in folds:
            seen = [~mask for mask in fold]
            H, _ = self._total(reduced, seen)
            _, g = self._total(reduced, fold)
            before = sum(
                float(loss(line.cost[mask], line.usual).sum()) for line, mask in zip(fit.lines, seen, strict=True)
            )
            damping = HELD_DAMPING
            while True:  # until the step spoils the windows that it was made from no longer
                moved = self._moved(H, -g, self._vector(fit), damping)
                there = [stage.at(self.named(moved)) for stage in self.stages]
                trained = self._begun(fit, moved, there, seen)
                after = sum(float(loss(cost, fit.lines[i].usual).sum()) for i, _, _, cost in trained)
                if after < SPOILT * before or damping > WORST:
                    break
                damping *= 30.0
            yield from ((i, mask, work) for i, mask, work, _ in self._begun(fit, moved, there, fold))

    def _vector(self, fit: Fit) -> Array:
        return np.array([fit.theta[name] for name in self.names])

    def _begun(
        self, fit: Fit, moved: Array, there: Sequence[StageProblem], masks: Sequence[NDArray[np.bool_]]
    ) -> Iterator[tuple[int, NDArray[np.bool_], "_Work", Array]]:
        """Yield (stage, windows, work, cost) for some windows at other parameters, initial states following."""
        step = moved - self._vector(fit)
        for i, (stage, line, mask) in enumerate(zip(self.stages, fit.lines, masks, strict=True)):
            if mask.any():
                work = _Work(there[i], {}, np.flatnonzero(mask))
                kept = fit.initial[i][:, mask]
                start = kept.copy()
                start[work.rows] += line.follow(step[self.places(stage)], 0.0)[:, mask]
                for row in stage.memory:
                    kept[row] = start[row] = work.initial[row]
                yield i, mask, work, work.begin({}, kept, start)

    def covariance(self, fit: Fit, blocks: Sequence[NDArray[np.int64]]) -> Array:
        """Return the covariance of θ (N, N), robust against errors that are alike within blocks of windows.

        A⁻¹ (S⁻² + Σ_b g_b g_bᵀ) A⁻¹ with A = H + S⁻², S the priors' deviations, g_b the gradient of a block.
        """
        reduced = fit.reduced()
        H, _ = self._total(reduced)
        inverse = np.linalg.inv(H + np.diag(self.scale**-2.0))
        meat = np.diag(self.scale**-2.0)
        for stage, (_, slope), block in zip(self.stages, reduced, blocks, strict=True):
            place = self.places(stage)
            sums = np.stack([np.bincount(block, column) for column in slope.T], axis=1)  # (B, N)
            sums -= sums.mean(axis=0)
            meat[np.ix_(place, place)] += sums.T @ sums
        covariance: Array = inverse @ meat @ inverse
        return covariance


def expected_errors(stage: StageProblem, theta: Mapping[str, float], initial: Array, noise: Array, seed: int) -> Array:
    """Return the errors (T + 1, C, W) that a right vehicle would leave: one draw of the sensors' `noise` (C,).

    Noise of measured inputs counts: it drives the car that is simulated, not the one that was measured.
    """
    generator = np.random.default_rng(seed)
    alone = stage.at(theta)
    still = replace(alone.windows({}), initial=initial)
    truth = stage.rollout.predict(alone.parameters({}), still)
    noisy = replace(alone, evidence=stage.evidence.with_noisy_inputs(generator))
    work = _Work(noisy, {}, None)
    shown = truth + noise[:, None] * generator.standard_normal(truth.shape)
    work.windows = replace(work.windows, measured=np.ascontiguousarray(shown))
    work.initial = initial.copy()
    work.settled()
    return work.errors({})


@dataclass(frozen=True)
class _Slope:
    """F at a place, and every stage there."""

    cost: float
    lines: list[Linear]


class _Landscape:
    """F over θ and the initial states (S, W) of every stage, in the course of a fit."""

    def __init__(self, problem: Problem, work: Sequence["_Work"]) -> None:
        self.problem, self.work = problem, work

    def linearise(self, place: "_Place") -> _Slope:
        theta = self.put(place)
        lines = [stage.linearise(theta) for stage in self.work]
        total = sum(line.loss for line in lines) + self.problem.prior(place[0])
        return _Slope(total if np.isfinite(total) else np.inf, lines)

    def cost(self, place: "_Place") -> float:
        theta = self.put(place)
        return sum((stage.losses(theta) for stage in self.work), self.problem.prior(place[0]))

    def step(self, place: "_Place", slope: _Slope, damping: float) -> "_Place":
        self.put(place)
        vector = place[0]
        trial = self.problem.step(slope.lines, vector, damping)
        theta = self.problem.named(trial)
        for stage, line in zip(self.work, slope.lines, strict=True):
            stage.move(theta, line, (trial - vector)[self.problem.places(stage.problem)], damping)
        return trial, [stage.initial for stage in self.work]

    def put(self, place: "_Place") -> dict[str, float]:
        """Put the windows' initial states there; return θ."""
        for stage, initial in zip(self.work, place[1], strict=True):
            stage.initial = initial
        return self.problem.named(place[0])


_Place = tuple[Array, list[Array]]


class _Work:
    """A stage's windows in the course of a fit."""

    def __init__(self, problem: StageProblem, theta: Mapping[str, float], index: NDArray[np.int64] | None) -> None:
        self.problem, self.index = problem, index
        self.windows = self._cut(theta)
        self.initial = self.windows.initial.copy()
        if problem.vehicle.states != STATE:
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
        """Return 1/s_0² of an initial state; zero for the car's own."""
        if name in STATE:
            return self.problem.evidence.trust(name)
        effect, _, state = name.partition(".")
        told = state in self.problem.vehicle.effects[effect].told
        spread = FIXED if told else OWN_SPREAD * float(np.std(row)) + 1e-4
        return spread**-2

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
    ) -> None:
        """Take the initial states' step when θ moves by `moved`.

        Where own states make the way rough, a window that this does not help takes whichever damping leads it lowest.
        """
        kept, ways = self.initial, WAYS if self.remembers else ()
        first, *others = (kept + self.spread(line, moved, each) for each in (damping, *ways))
        self.initial = first
        if self.remembers or wait:
            self.begin(theta, first, kept)
        stuck = np.flatnonzero((self.initial == kept).all(axis=0))
        if others and len(stuck):
            part = self.some(stuck)
            part.begin(theta, *(each[:, stuck] for each in (*others, kept)))
            self.initial[:, stuck] = part.initial

    def some(self, chosen: NDArray[np.int64]) -> "_Work":
        """Return the work on some of the windows."""
        part = copy.copy(self)
        part.index = chosen if self.index is None else self.index[chosen]
        part.windows, part.initial, part.rest = self.windows.take(chosen), self.initial[:, chosen], self.rest[:, chosen]
        return part

    def begin(self, theta: Mapping[str, float], *initials: Array) -> Array:
        """Start every window from the initial state that fits it best; return the cost per window (W,)."""
        costs = []
        for initial in initials:
            self.initial = initial
            costs.append(self.cost(theta))
        known = np.nan_to_num(costs, nan=np.inf)
        self.initial = np.choose(np.argmin(known, axis=0), initials)
        return known.min(axis=0)

    def settled(self) -> Array:
        """Return the cost per window once every initial state has taken its own steps, as long as they help."""
        line = self.linearise({})
        for _ in range(SETTLING):
            before = line.cost
            self.move({}, line, np.zeros(0), 0.0, wait=True)
            line = self.linearise({})
            if not (line.cost < (1.0 - ENOUGH) * before).any():
                break
        return line.cost

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

    def losses(self, theta: Mapping[str, float]) -> float:
        """Return the summed loss of the windows, n as where the fit began; infinite where one blew up."""
        with np.errstate(all="ignore"):
            total = float(loss(self.cost(theta), self.usual).sum())
        return total if np.isfinite(total) else np.inf

    def cost(self, theta: Mapping[str, float]) -> Array:
        """Return the cost per window (W,), as the initial states are."""
        windows, parameters = self._now(theta), self.problem.parameters(theta)
        with np.errstate(all="ignore"):
            squares = self.problem.rollout.squares(parameters, windows).sum(axis=1)
            return np.asarray(squares + (self._away() ** 2 * self.precision).sum(axis=1))

    def _now(self, theta: Mapping[str, float]) -> Windows:
        """Return the windows with inputs at θ's shifts, from the initial states as they are."""
        self._shift(theta)
        return replace(self.windows, initial=self.initial + self.drift(theta)[0])
