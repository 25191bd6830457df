"""What a fit of the gap workflow minimises: squared errors over the noise, summed over stages that share parameters.

    F(θ, x_0) = Σ_stages Σ_windows ρ(c) + Σ λ ((θ − θ_0)/s)²
    c = Σ_c,t ((y − m)/σ_c)² + Σ_own λ ((x_0 − x̄_0)/s_0)²,    ρ(c) = 2√2 n (√(1 + c/n) − 1)

Every window has a free initial state x_0; the effects' own states begin near where the measured motion puts them. With
n the cost of a usual window, ρ (pseudo-Huber) counts such windows by their cost and those that no vehicle foresees, a
spin, by its root: they do not decide alone. Where the model leaves more than noise, N numbers that hang together are
worth fewer: λ = max(1, F_data/N_independent) of a stage makes the priors of the vehicle's parameters in it, and of own
states, as strong as they should be beside such data: else an effect with states of its own would explain anything by
where every window begins. Levenberg–Marquardt on the normal equations with windows weighted by ρ'(c), initial
states eliminated window by window.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from racerl.estimation.levenberg_marquardt import WORST, bounded_step, descend
from racerl.estimation.pseudo_huber import pseudo_huber
from racerl.estimation.unknowns import Unknown, unsure
from racerl.gap.normal_equations import Linear
from racerl.gap.stage_fit import StageFit
from racerl.gap.stage_problem import StageProblem

Array = NDArray[np.float64]
HELD_DAMPING = 1e-2  # of the step to a fold's parameters, at first
SPOILT = 1.02  # times the cost of the windows that a step was made from, above which it went too far


@dataclass
class Fit:
    """Parameters found, and per stage initial states and cost by window, priors of θ apart."""

    theta: dict[str, float]
    initial: list[Array]
    cost: list[Array]
    strength: list[float]  # λ of every stage that its residuals ask for
    why: str  # it is no minimum; "" if it is one
    linearise: Callable[[], list[Linear]]  # a fit of a checkpoint is without: few are asked for it

    @property
    def converged(self) -> bool:
        """Whether an undamped step gains nothing there."""
        return not self.why

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
            "why": np.frombuffer(self.why.encode(), dtype=np.uint8),
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
        return cls(theta, initial, cost, parts["strength"].tolist(), parts["why"].tobytes().decode(), linearise)


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
        work = [
            StageFit(stage, theta, None if index is None else index[i], self.strength[i])
            for i, stage in enumerate(self.stages)
        ]
        for i, stage in enumerate(work):
            if initial is not None:
                stage.take(theta, initial[i])
        vector = np.array([theta[name] for name in self.names])
        start = Place(vector, [stage.initial for stage in work], [])
        landscape = Landscape(self, work)
        end = descend(landscape, start, iterations, tolerance)
        landscape.put(end.place)  # the step tried last may have been in vain
        return self._result(work, end.place.theta, end.slope.lines, end.why)

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

    def _result(self, work: Sequence[StageFit], vector: Array, lines: list[Linear], why: str) -> Fit:
        theta = self.named(vector)
        initial = [stage.initial + stage.drift(theta)[0] for stage in work]
        strength = [stage.strength(theta, line) for stage, line in zip(work, lines, strict=True)]
        return Fit(theta, initial, [line.cost for line in lines], strength, why, lambda: lines)

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
    ) -> Iterator[tuple[int, NDArray[np.bool_], StageFit]]:
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
                float(pseudo_huber(line.cost[mask], line.usual).sum())
                for line, mask in zip(fit.lines, seen, strict=True)
            )
            damping = HELD_DAMPING
            while True:  # until the step spoils the windows that it was made from no longer
                moved = self._moved(H, -g, self._vector(fit), damping)
                there = [stage.at(self.named(moved)) for stage in self.stages]
                trained = self._begun(fit, moved, there, seen)
                after = sum(float(pseudo_huber(cost, fit.lines[i].usual).sum()) for i, _, _, cost in trained)
                if after < SPOILT * before or damping > WORST:
                    break
                damping *= 30.0
            yield from ((i, mask, work) for i, mask, work, _ in self._begun(fit, moved, there, fold))

    def _vector(self, fit: Fit) -> Array:
        return np.array([fit.theta[name] for name in self.names])

    def _begun(
        self, fit: Fit, moved: Array, there: Sequence[StageProblem], masks: Sequence[NDArray[np.bool_]]
    ) -> Iterator[tuple[int, NDArray[np.bool_], StageFit, Array]]:
        """Yield (stage, windows, work, cost) for some windows at other parameters, initial states following."""
        step = moved - self._vector(fit)
        for i, (stage, line, mask) in enumerate(zip(self.stages, fit.lines, masks, strict=True)):
            if mask.any():
                work = StageFit(there[i], {}, np.flatnonzero(mask), self.strength[i])
                kept = fit.initial[i][:, mask]
                start = kept.copy()
                start[work.rows] += line.follow(step[self.places(stage)], 0.0)[:, mask]
                for row in stage.memory:
                    kept[row] = start[row] = work.initial[row]
                yield i, mask, work, work.begin({}, kept, start)

    def covariance(self, fit: Fit, blocks: Sequence[NDArray[np.int64]]) -> Array:
        """Return the covariance of θ (N, N), robust against errors that are alike within blocks of windows.

        `blocks` (W,) per stage, numbered alike in all of them.

        Σ_b Δ_b Δ_bᵀ + A⁻¹ M A⁻¹ with A = H + λ/s². Δ_b = (A − H_b)⁻¹ (g_b − ḡ) is how far θ moves without block b (the
        jackknife: where few blocks tell of a parameter, the fit follows them, and their gradients come out small).
        M = max(1, d²) λ²/s² is what a prior draws by: its mean is as unsure as s says, or as far as the fit has gone
        from it, d = (θ − θ_0)/s.
        """
        reduced = fit.reduced()
        H, _ = self._total(reduced)
        stiffness = H + np.diag(self.scale**-2.0)
        sigma = np.array([unknown.sigma for unknown in self.unknowns])
        drawn = np.linalg.inv(stiffness) * unsure((self._vector(fit) - self.mean) / sigma) * sigma / self.scale**2
        count, size = 1 + max(int(block.max()) for block in blocks), len(stiffness)
        curvature, gradient = np.zeros((count, size, size)), np.zeros((count, size))
        for stage, (part, slope), block in zip(self.stages, reduced, blocks, strict=True):
            place = np.array(self.places(stage), int)
            np.add.at(curvature, (block[:, None, None], *np.ix_(place, place)), part)
            np.add.at(gradient, (block[:, None], place), slope)
        moved = np.linalg.solve(stiffness - curvature, (gradient - gradient.mean(axis=0))[:, :, None])[:, :, 0]
        covariance: Array = drawn @ drawn.T + moved.T @ moved
        return covariance


class Place(NamedTuple):
    """θ, every stage's initial states (S, W), and what its windows cost there (W,), but for where a fit starts."""

    theta: Array
    initial: list[Array]
    cost: list[Array]


@dataclass(frozen=True)
class Slope:
    """F at a place, and every stage there."""

    cost: float
    lines: list[Linear]


class Landscape:
    """F over θ and the initial states (S, W) of every stage, in the course of a fit."""

    def __init__(self, problem: Problem, work: Sequence[StageFit]) -> None:
        self.problem, self.work = problem, work

    def linearise(self, place: Place) -> Slope:
        """Return F at a place, and every stage there."""
        theta = self.put(place)
        lines = [stage.linearise(theta) for stage in self.work]
        total = sum(line.loss for line in lines) + self.problem.prior(place.theta)
        return Slope(total if np.isfinite(total) else np.inf, lines)

    def cost(self, place: Place) -> float:
        """Return F at a place that a step led to."""
        losses = (stage.losses(cost) for stage, cost in zip(self.work, place.cost, strict=True))
        return sum(losses, self.problem.prior(place.theta))

    def step(self, place: Place, slope: Slope, damping: float) -> Place:
        """Return where a damped step leads."""
        self.put(place)
        trial = self.problem.step(slope.lines, place.theta, damping)
        theta, moved = self.problem.named(trial), trial - place.theta
        cost = [
            stage.move(theta, line, moved[self.problem.places(stage.problem)], damping)
            for stage, line in zip(self.work, slope.lines, strict=True)
        ]
        return Place(trial, [stage.initial for stage in self.work], cost)

    def put(self, place: Place) -> dict[str, float]:
        """Put the windows' initial states there; return θ."""
        for stage, initial in zip(self.work, place.initial, strict=True):
            stage.initial = initial
        return self.problem.named(place.theta)
