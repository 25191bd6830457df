"""The engine of the gap workflow: fits of a vehicle with any set of effects to every stage that they touch.

Stages that no effect of a set touches keep the nominal fit, so that sets are compared by what they change. Fits over
all windows rank; fits that leave folds of runs out decide.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from racerl.data.log import Log
from racerl.gap.evidence import Evidence
from racerl.gap.problem import Fit, Problem, Score, StageKernels, StageProblem, Unknown, merged, score
from racerl.gap.stage import STAGES
from racerl.identify.unknowns import Unknowns
from racerl.vehicle.effects import Effect
from racerl.vehicle.parameter import replace_values, specifications, values
from racerl.vehicle.vehicle import STATE, Vehicle

Array = NDArray[np.float64]
Names = frozenset[str]
SHARE = 0.1  # of a channel's misfit that counts as noise in its weight
NOMINAL, SCREEN, REFINE = 25, 3, 8  # most iterations of the nominal fit, of screening, of a candidate on the shortlist
SAMPLED = 3  # every which window screening looks at
WIDE = 3.0  # deviation of an effect's parameters, in their usual sizes


@dataclass
class Found:
    """The best fit of a vehicle with some effects, over the stages that they touch; cost per stage's window."""

    effects: Names
    vehicle: Vehicle  # with the fitted values
    theta: dict[str, float]
    initial: dict[str, Array]
    cost: dict[str, Array]
    fit: Fit
    problem: Problem


class Investigation:
    """Logs, cut for every stage, and all that was fitted to them."""

    def __init__(
        self,
        logs: Sequence[Log],
        vehicle: Vehicle,
        nominal: Unknowns,
        catalogue: Mapping[str, Sequence[Effect]],
        *,
        length: int = 85,
        slowest: float = 0.5,
        folds: int = 4,
        threads: int = 1,
    ) -> None:
        cut = [Evidence.of(logs, stage, length, slowest) for stage in STAGES]
        self.evidence = {each.stage.name: each for each in cut if each is not None and len(each.start)}
        self.vehicle, self.catalogue, self.threads = vehicle, catalogue, threads
        self.unknowns = [
            Unknown(*row)
            for row in zip(
                nominal.names,
                nominal.start.tolist(),
                nominal.sigma.tolist(),
                nominal.low.tolist(),
                nominal.high.tolist(),
                strict=True,
            )
        ]
        free, any_size = [unknown.name for unknown in self.unknowns], {n: e[0] for n, e in catalogue.items()}
        self.kernels = {name: StageKernels(each, vehicle, free, any_size) for name, each in self.evidence.items()}
        self.noise = {name: each.noise() for name, each in self.evidence.items()}
        self.sigma = dict(self.noise)
        self.base = self._nominal()
        self.folds = self._deal(folds)
        self._known: dict[Names, Found] = {frozenset(): self.base}

    def _nominal(self) -> Found:
        """Fit the vehicle without effects; weigh channels by their noise and a share of what is left over."""
        found = self._fit(frozenset(), self.vehicle, None, NOMINAL)
        for name, evidence in self.evidence.items():
            stage = next(s for s in found.problem.stages if s.evidence is evidence)
            windows = replace(stage.windows(found.theta), initial=found.initial[name])
            error = stage.rollout.predict(stage.parameters(found.theta), windows, self.threads) - windows.measured
            self.sigma[name] = np.sqrt(self.noise[name] ** 2 + SHARE**2 * (error**2).mean(axis=(0, 2)))
        return self._fit(frozenset(), found.vehicle, found, NOMINAL)

    def _fit(
        self,
        effects: Names,
        vehicle: Vehicle,
        start: Found | None,
        iterations: int,
        stages: Iterable[str] | None = None,
        index: Mapping[str, NDArray[np.int64]] | None = None,
    ) -> Found:
        names = list(self.evidence if stages is None else stages)
        unknowns = [*self.unknowns, *(unknown for name in sorted(effects) for unknown in _free(vehicle, name))]
        problem = Problem(
            [
                StageProblem.of(self.evidence[n], self.kernels[n], vehicle, unknowns, self.sigma[n], self.threads)
                for n in names
            ],
            unknowns,
        )
        table = {name: float(value) for name, value in values(vehicle).items()}
        initial = None if start is None else [start.initial[name] for name in names]
        if initial is not None and index is not None:
            initial = [part[:, index[name]] for name, part in zip(names, initial, strict=True)]
        chosen = None if index is None else [index[name] for name in names]
        fit = problem.fit({n: table[n] for n in problem.names}, initial, chosen, iterations)
        fitted = replace_values(vehicle, fit.theta)
        return Found(
            effects,
            fitted,
            {name: float(value) for name, value in values(fitted).items()},
            dict(zip(names, fit.initial, strict=True)),
            dict(zip(names, fit.cost, strict=True)),
            fit,
            problem,
        )

    def touched(self, vehicle: Vehicle, effects: Names) -> list[str]:
        """Return the stages whose outcome depends on a parameter of the effects."""
        found = []
        for name, evidence in self.evidence.items():
            unknowns = [unknown for effect in effects for unknown in _free(vehicle, effect)]
            if StageProblem.touched(evidence, self.kernels[name], vehicle, unknowns):
                found.append(name)
        return found

    def screen(self, base: Found, name: str) -> Vehicle | None:
        """Add an effect to a fitted vehicle: a few steps from each of its usual sizes, on a share of the windows.

        Return the vehicle of the best size; None where no stage shows the effect.
        """
        best: tuple[float, Vehicle] | None = None
        for effect in self.catalogue[name]:
            vehicle = replace(base.vehicle, effects={**base.vehicle.effects, name: effect})
            stages = self.touched(vehicle, frozenset([name]))
            if not stages:
                return None
            some = {stage: np.arange(len(self.evidence[stage].start))[::SAMPLED] for stage in stages}
            start = self._start(base, stages)
            found = self._fit(base.effects | {name}, vehicle, start, SCREEN, stages, some)
            gain = float(sum((self.cost(base, s)[some[s]] - found.cost[s]).sum() for s in stages))
            if best is None or gain > best[0]:
                best = gain, found.vehicle
        return None if best is None else best[1]

    def score(self, base: Found) -> Score:
        """Return the score of every effect that a fitted vehicle lacks, summed over the stages."""
        total: Score | None = None
        start = self._start(base, self.evidence)
        for name, evidence in self.evidence.items():
            unknowns = [*self.unknowns, *(u for effect in sorted(base.effects) for u in _free(base.vehicle, effect))]
            problem = StageProblem.of(
                evidence, self.kernels[name], base.vehicle, unknowns, self.sigma[name], self.threads
            )
            found = score(problem, base.theta, self._padded(start.initial[name], problem))
            total = found if total is None else merged(total, found)
        assert total is not None  # noqa: S101
        return total

    def _padded(self, initial: Array, problem: StageProblem) -> Array:
        states = len(problem.rollout.vehicle.states)
        padded = np.zeros((states, initial.shape[1]))
        padded[: len(initial)] = initial[:states]
        return padded

    def add(self, base: Found, vehicle: Vehicle) -> Found:
        """Fit a vehicle that has more effects than a fitted one to the end, over the stages that they touch."""
        more = frozenset(vehicle.effects) - base.effects
        stages = self.touched(vehicle, more | base.effects)
        return self._fit(base.effects | more, vehicle, self._start(base, stages), REFINE, stages)

    def _start(self, base: Found, stages: Iterable[str]) -> Found:
        missing = {name: self.base.initial[name] for name in stages if name not in base.initial}
        return replace_found(base, {**base.initial, **missing})

    def gain(self, base: Found, found: Found) -> float:
        """Return by how much the cost falls over the stages that both were fitted to, in squared deviations."""
        return float(sum(self.cost(base, name).sum() - cost.sum() for name, cost in found.cost.items()))

    def cost(self, found: Found, stage: str) -> Array:
        """Return a fit's cost per window of a stage; the nominal one where its effects do not touch it."""
        return found.cost.get(stage, self.base.cost[stage])

    def _deal(self, count: int) -> list[dict[str, NDArray[np.bool_]]]:
        """Return masks of the windows that each fold holds out: whole runs, or stretches where runs are few."""
        masks: list[dict[str, NDArray[np.bool_]]] = [{} for _ in range(count)]
        for name, evidence in self.evidence.items():
            runs, size = np.unique(evidence.run, return_counts=True)
            if len(runs) >= 2 * count:
                order = runs[np.argsort(-size, kind="stable")]
                for number in range(count):
                    masks[number][name] = np.isin(evidence.run, order[number::count])
            else:
                block = (np.arange(len(evidence.start)) * count * 3) // max(len(evidence.start), 1)
                for number in range(count):
                    masks[number][name] = block % count == number
        return masks

    def held_out(self, found: Found, iterations: int = 4) -> dict[str, Array]:
        """Return the cost of every window under a fit that has not seen its fold, per stage."""
        names = list(found.cost)
        cost = {name: np.zeros(len(self.evidence[name].start)) for name in names}
        for mask in self.folds:
            seen = {name: np.flatnonzero(~mask[name]) for name in names}
            unseen = {name: np.flatnonzero(mask[name]) for name in names}
            part = self._fit(found.effects, found.vehicle, found, iterations, names, seen)
            judged = found.problem.fit(
                {name: part.theta[name] for name in found.problem.names},
                [found.initial[name][:, unseen[name]] for name in names],
                [unseen[name] for name in names],
                3,
                hold=True,
            )
            for name, got in zip(names, judged.cost, strict=True):
                cost[name][unseen[name]] = got
        return cost


def replace_found(found: Found, initial: dict[str, Array]) -> Found:
    """Return a fit with the initial states of more stages; those of effects' own states are found anew."""
    return replace(found, initial={name: part[: len(STATE)] for name, part in initial.items()})


def _free(vehicle: Vehicle, effect: str) -> list[Unknown]:
    """Return an effect's parameters as unknowns, with wide priors."""
    table, known = values(vehicle), specifications(vehicle)
    names = [name for name in table if name.startswith(f"effects.{effect}.")]
    return [
        Unknown(
            name,
            float(table[name]),
            WIDE * max(abs(float(table[name])), 0.01 * min(1.0, known[name].high - known[name].low)),
            known[name].low,
            known[name].high,
        )
        for name in names
    ]
