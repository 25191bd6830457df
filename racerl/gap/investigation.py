"""The engine of the gap workflow: fits of a vehicle with any set of effects to every stage that they touch.

Stages that no effect of a set touches keep the nominal fit, so that sets are compared by what they change. Fits over
all windows rank; folds of stretches that are left out decide.
"""

import copy
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import CancelledError, ThreadPoolExecutor
from dataclasses import dataclass, replace
from threading import Event
from typing import Any, NamedTuple, TypeVar
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from racerl.estimation.unknowns import Unknowns
from racerl.gap.catalogue import placed
from racerl.gap.checkpoint import Checkpoint, Parts
from racerl.gap.evidence import Evidence
from racerl.gap.growth import places
from racerl.gap.kernels import StageKernels
from racerl.gap.problem import Fit, Problem, StageProblem, Unknown, expected_errors, loss, usual_cost
from racerl.gap.score import Score, score, summed
from racerl.vehicle.effects import Effect
from racerl.vehicle.parameter import replace_values, specifications, values
from racerl.vehicle.vehicle import Vehicle

Array = NDArray[np.float64]
Names = frozenset[str]
Item = TypeVar("Item")
Result = TypeVar("Result")
SHARE = 0.1  # of a channel's misfit that counts as noise in its weight
NOMINAL, SCREEN, REFINE = 60, 3, 8  # most iterations of the nominal fit, of screening, of a candidate
CALM = 10.0  # times the noise's cost in a usual window, beyond which a window's tells of the vehicle
ASTRAY = 1.3  # times the noise's cost, beyond which a fit says little of the parameters
PLACES, REACH = 2, 1.5  # of an effect that lies somewhere: places that fits start from, and their size in m
SAMPLED = 3  # every which window screening, and the nominal fit to the shortest windows, look at
GROWTH = (10, 30)  # samples of the windows that the nominal fit looks at first: errors grow less crooked in them
STARTS, TWICE = 6, 0.01  # most starts of the nominal fit; share by which two that end at the best differ
ROUNDS, SETTLED = 4, 1.5  # most fits with the priors' strength set anew, until it changes by less than this factor
STRETCH = 6  # windows that are held out together
EVEN = 0.05  # excess over the noise's cost at which an actuator's command counts as rightly timed
PROBE, MENDED = 0.1, 0.15  # of a sample earlier must take so much of an excess away for a command's timing to matter
FAR = 2.0  # prior deviations, beyond which a refitted parameter is a clue in itself
COG = "cog_longitudinal_offset"  # takes the place of l_f, which is then as weighed
WIDE = 3.0  # deviation of an effect's parameters, in their usual sizes


@dataclass(eq=False)
class Found:
    """The best fit of a vehicle with some effects, over the stages that they touch; cost per stage's window."""

    effects: Names
    vehicle: Vehicle  # with the fitted values
    theta: dict[str, float]
    initial: dict[str, dict[str, Array]]  # of every stage's states
    cost: dict[str, Array]
    strength: dict[str, float]  # λ that every stage's residuals ask for
    fit: Fit
    problem: Problem
    key: str  # of all that it came from


class Screened(NamedTuple):
    """A candidate after a few steps: the vehicle that it led to, its gain, and the stage that gains most."""

    name: str
    vehicle: Vehicle
    gain: float
    stage: str


class Investigation:
    """Logs, cut for every stage, and all that was fitted to them."""

    def __init__(
        self,
        evidence: Mapping[str, Evidence],
        vehicle: Vehicle,
        nominal: Unknowns,
        catalogue: Mapping[str, Sequence[Effect]],
        *,
        limits: Mapping[str, tuple[float, float]] | None = None,
        folds: int = 8,
        threads: int = 1,
        seed: int = 0,
        checkpoint: Checkpoint | None = None,
    ) -> None:
        self.evidence = dict(evidence)
        self.checkpoint, self.stopped = checkpoint or Checkpoint(), Event()
        self.vehicle, self.catalogue, self.threads = vehicle, catalogue, threads
        self.limits = dict(limits or {})
        self.unknowns = [
            Unknown(name, start, sigma, *self.limits.get(name, (low, high)))
            for name, start, sigma, low, high in zip(
                nominal.names,
                nominal.start.tolist(),
                nominal.sigma.tolist(),
                nominal.low.tolist(),
                nominal.high.tolist(),
                strict=True,
            )
        ]
        self.kernels = self._kernels(catalogue)
        self.noise = {name: each.noise() for name, each in self.evidence.items()}
        self.sigma = dict(self.noise)
        self.strength = dict.fromkeys(self.evidence, 1.0)  # λ of the priors where nothing was fitted
        for name in {"steering", "drive"} & set(self.evidence):
            self.evidence[name] = self._timed(name)
        self.base = self._nominal(self._drawn(nominal, np.random.default_rng(0)))  # whatever the seed: one log, one fit
        self.strength = self.base.strength
        self.seed = seed
        self._held_out: WeakKeyDictionary[Found, dict[str, Array]] = WeakKeyDictionary()
        self._noise_cost: WeakKeyDictionary[Found, dict[str, float]] = WeakKeyDictionary()
        self.noise_errors = self.expected(self.base)
        self.floor = self._squares(self.noise_errors)
        self.folds = self._deal(folds)

    def _kernels(self, catalogue: Mapping[str, Sequence[Effect]]) -> dict[str, StageKernels]:
        free, any_size = [unknown.name for unknown in self.unknowns], {n: e[0] for n, e in catalogue.items()}
        return {name: StageKernels(each, self.vehicle, free, any_size) for name, each in self.evidence.items()}

    def each(
        self,
        function: Callable[[Item], Result],
        items: Sequence[Item],
        on_progress: Callable[[Item, float], None] = lambda item, share: None,
    ) -> list[Result]:
        """Return a function of every item, in their order; all threads work, and their number changes nothing.

        Where one fails, or the user interrupts, the others end before their next fit.
        """
        results = []
        with ThreadPoolExecutor(self.threads) as pool:
            try:
                for item, result in zip(items, pool.map(function, items), strict=True):
                    results.append(result)
                    on_progress(item, len(results) / len(items))
            except BaseException:
                self.stopped.set()
                raise
        return results

    def go_on(self) -> None:
        """Raise CancelledError where another thread has failed or was interrupted."""
        if self.stopped.is_set():
            raise CancelledError

    def knowing(self, catalogue: Mapping[str, Sequence[Effect]]) -> "Investigation":
        """Return the same logs and refitted vehicle with another catalogue of effects."""
        other = copy.copy(self)
        other.catalogue, other.kernels = catalogue, self._kernels(catalogue)
        return other

    def limited(self, limits: Mapping[str, tuple[float, float]]) -> "Investigation":
        """Return the same logs and refitted vehicle with other limits of some effects' parameters."""
        other = copy.copy(self)
        other.limits = {**self.limits, **limits}
        return other

    def _timed(self, stage: str) -> Evidence:
        """Return an actuator's evidence with its command as early as lets the vehicle reach the noise, where one does.

        What is sent between two samples is logged with the later one.
        """
        given = self.evidence[stage]
        enough = (1.0 + EVEN) * given.numbers * len(given.start)

        def cost(early: float) -> float:
            self.evidence[stage] = replace(given, early=float(early))
            return float(self._fit(frozenset(), self.vehicle, None, NOMINAL, [stage]).cost[stage].sum())

        late = cost(0.0)
        if late <= enough or late - cost(PROBE * given.dt) < MENDED * (late - enough):
            return given
        best = minimize_scalar(cost, bounds=(0.0, given.dt), method="bounded", options={"xatol": 0.02 * given.dt})
        return replace(given, early=float(best.x)) if best.fun <= enough else given

    def _drawn(self, nominal: Unknowns, generator: np.random.Generator) -> list[Vehicle]:
        """Return the configured vehicle and others within one prior deviation of it."""
        starts = [nominal.draw_within(generator).tolist() for _ in range(STARTS - 1)]
        others = [replace_values(self.vehicle, dict(zip(nominal.names, start, strict=True))) for start in starts]
        return [self.vehicle, *others]

    def _nominal(self, starts: Sequence[Vehicle]) -> Found:
        """Fit the vehicle without effects; weigh channels by their noise and a share of what is left over."""
        found: list[Found] = []
        while len(found) < len(starts) and not self._met_twice(found):
            found += self.each(self._grown, starts[len(found) : len(found) + 2])
        self.met_twice = self._met_twice(found)
        best = min(found, key=self._loss)
        for name, errors in self.errors(best).items():
            left = (errors**2).mean(axis=(0, 2))
            self.noise[name] = np.minimum(self.noise[name], np.sqrt(left))  # local polynomials miss fast motion
            self.sigma[name] = np.sqrt(self.noise[name] ** 2 + SHARE**2 * left)
        return self._settled(frozenset(), best.vehicle, best)

    def _met_twice(self, found: Sequence[Found]) -> bool:
        """Return whether the two best fits ended at the same cost."""
        losses = sorted(self._loss(each) for each in found)
        return len(losses) > 1 and losses[1] <= (1.0 + TWICE) * losses[0]

    def doubts(self) -> list[str]:
        """Return what speaks against the refit's being the best there is, a line each."""
        lines = []
        if not self.met_twice:
            lines.append(f"the refit ended elsewhere from each of {STARTS} starts: another may fit better")
        if not self.base.fit.converged:
            lines.append(f"the refit still gained after {ROUNDS * NOMINAL} steps: it may not be the best there is")
        return lines

    def _grown(self, vehicle: Vehicle) -> Found:
        """Fit the vehicle without effects to windows that grow, so that it gets to where long ones lead it right."""
        strength = self.strength
        for length in GROWTH:
            shorter = {name: each.parted(length) for name, each in self.evidence.items() if each.length > length}
            if set(shorter) == set(self.evidence):
                index = _sampled(shorter) if length == GROWTH[0] else None
                found = self._settled(frozenset(), vehicle, None, shorter, index, strength)
                vehicle, strength = found.vehicle, found.strength
        return self._settled(frozenset(), vehicle, None, strength=strength)

    def _settled(
        self,
        effects: Names,
        vehicle: Vehicle,
        start: Found | None,
        evidence: Mapping[str, Evidence] | None = None,
        index: Mapping[str, NDArray[np.int64]] | None = None,
        strength: Mapping[str, float] | None = None,
        stages: Iterable[str] | None = None,
    ) -> Found:
        """Fit until the priors are as strong as what the fit leaves asks for."""
        for _ in range(ROUNDS):
            found = self._fit(effects, vehicle, start, NOMINAL, stages, index, evidence=evidence, strength=strength)
            given, asked = found.problem.strength, found.fit.strength
            if all(1.0 / SETTLED < new / old < SETTLED for new, old in zip(asked, given, strict=True)):
                break
            vehicle, strength = found.vehicle, found.strength
            start = found if index is None else None
        return found

    def _loss(self, found: Found) -> float:
        """Return the loss of a fit, its priors apart, n the noise's cost; infinite where a window blew up."""
        parts = (float(loss(part, self.evidence[name].numbers).sum()) for name, part in found.cost.items())
        return float(np.nan_to_num(sum(parts), nan=np.inf))

    def _fit(
        self,
        effects: Names,
        vehicle: Vehicle,
        start: Found | None,
        iterations: int,
        stages: Iterable[str] | None = None,
        index: Mapping[str, NDArray[np.int64]] | None = None,
        free: Sequence[Unknown] | None = None,
        evidence: Mapping[str, Evidence] | None = None,
        strength: Mapping[str, float] | None = None,
    ) -> Found:
        """Fit all windows of some stages, or those of `index`; as strong priors as `start` asks for unless given."""
        evidence = evidence or self.evidence
        names = list(evidence if stages is None else stages)
        unknowns = self._unknowns(effects, vehicle) if free is None else free
        strength = strength or {**self.strength, **(start.strength if start else {})}
        if start is not None and set(names) < set(self.evidence):
            known = self._known_elsewhere(names)
            unknowns = [unknown for unknown in unknowns if unknown.name not in known]
        problem = Problem(
            [StageProblem.of(evidence[n], self.kernels[n], vehicle, unknowns, self.sigma[n]) for n in names],
            unknowns,
            [strength[name] for name in names],
        )
        table = {name: float(value) for name, value in values(vehicle).items()}
        initial = None if start is None else [_begun(stage, start.initial, index) for stage in problem.stages]
        chosen = None if index is None else [index[name] for name in names]
        theta = {n: table[n] for n in problem.names}
        key = self.checkpoint.key("fit", problem.told(), theta, initial, chosen, iterations)

        def worked_out() -> Fit:
            self.go_on()
            return problem.fit(theta, initial, chosen, iterations)

        if (parts := self.checkpoint.find(key)) is not None:
            fit = Fit.of(parts, problem.names, lambda: worked_out().lines)
        else:
            fit = worked_out()
            self.checkpoint.keep(key, fit.parts())
        fitted = replace_values(vehicle, fit.theta)
        return Found(
            effects,
            fitted,
            {name: float(value) for name, value in values(fitted).items()},
            {
                name: dict(zip(stage.rollout.vehicle.states, rows, strict=True))
                for name, stage, rows in zip(names, problem.stages, fit.initial, strict=True)
            },
            dict(zip(names, fit.cost, strict=True)),
            dict(zip(names, fit.strength, strict=True)),
            fit,
            problem,
            key,
        )

    def _known_elsewhere(self, stages: Sequence[str]) -> set[str]:
        """Return the vehicle's parameters that other stages than these determine: they stay as those found them."""
        others = [name for name in self.evidence if name not in stages]
        return self._determined(others) - self._determined(stages)

    def _determined(self, stages: Iterable[str]) -> set[str]:
        """Return the vehicle's parameters that the outcome of some stages depends on."""
        parts = {part.evidence.stage.name: set(part.names) for part in self.base.problem.stages}
        return set().union(*(parts[name] for name in stages))

    def _unknowns(self, effects: Names, vehicle: Vehicle) -> list[Unknown]:
        nominal = [unknown for unknown in self.unknowns if unknown.name != "l_f" or COG not in effects]
        return [*nominal, *(unknown for name in sorted(effects) for unknown in self._free(vehicle, name))]

    def _free(self, vehicle: Vehicle, effect: str) -> list[Unknown]:
        """Return an effect's parameters as unknowns, with wide priors, inside physical bounds or the log's own."""
        own = vehicle.effects[effect]
        if not own.physical:  # what is learned has its prior where it started, whatever it has become
            vehicle = with_effect(vehicle, effect, type(own)())
        table, known = values(vehicle), specifications(vehicle)
        held = own.known
        names = [n for n in table if n.startswith(f"effects.{effect}.") and n.rpartition(".")[2] not in held]
        return [
            Unknown(
                name,
                float(table[name]),
                WIDE * max(abs(float(table[name])), 0.01 * min(1.0, known[name].high - known[name].low)),
                *self.limits.get(name, (known[name].low, known[name].high)),
                effect=True,
            )
            for name in names
        ]

    def touched(self, vehicle: Vehicle, effects: Names) -> list[str]:
        """Return the stages whose outcome depends on a parameter of the effects."""
        found = []
        unknowns = [unknown for effect in effects for unknown in self._free(vehicle, effect)]
        for name, evidence in self.evidence.items():
            if StageProblem.touched(evidence, self.kernels[name], vehicle, unknowns):
                found.append(name)
        return found

    def screen(self, base: Found, name: str, fitted: Sequence[Effect] = ()) -> Screened | None:
        """Add an effect to a fitted vehicle: a few steps from each of its usual sizes, on a share of the windows.

        It starts as it was `fitted` beside fewer effects, too. Where the fit is astray, all parameters but the effects'
        start as configured, too. Return the best; None where no stage shows the effect.
        """
        likely = [self.joined(base.vehicle, name, effect) for effect in (*self._likely(base, name), *fitted)]
        stages = self.touched(likely[0], frozenset([name])) if likely else []
        if not stages:
            return None
        if self.beyond(base, stages) > ASTRAY:
            configured = values(self.vehicle)
            own = {name: float(configured[name]) for name in self._determined(stages)}
            likely += [replace_values(vehicle, own) for vehicle in likely]
        return max((self._try(base, name, vehicle, stages) for vehicle in likely), key=lambda each: each.gain)

    def joined(self, vehicle: Vehicle, name: str, effect: Effect) -> Vehicle:
        """Return a fitted vehicle with an effect more; a displaced centre of gravity starts from l_f as weighed."""
        vehicle = with_effect(vehicle, name, effect)
        return replace_values(vehicle, {"l_f": self.vehicle.l_f}) if name == COG else vehicle

    def _try(self, base: Found, name: str, vehicle: Vehicle, stages: Sequence[str]) -> Screened:
        """Return where a few iterations on a share of the windows lead a vehicle with an effect more."""
        some = _sampled({name: self.evidence[name] for name in stages})
        found = self._fit(base.effects | {name}, vehicle, self._start(base, stages), SCREEN, stages, some)
        gains = {s: self._fall(s, self.cost(base, s)[some[s]], found.cost[s]) for s in stages}
        return Screened(name, found.vehicle, sum(gains.values()), max(gains, key=lambda s: gains[s]))

    def _fall(self, stage: str, before: Array, after: Array) -> float:
        """Return the fall of the loss of a stage's windows."""
        usual = usual_cost(self.evidence[stage], before)
        return float((loss(before, usual) - loss(after, usual)).sum())

    def _likely(self, base: Found, name: str) -> list[Effect]:
        """Return the starts of an effect; one that lies somewhere starts where errors grow most.

        A centre of gravity that is elsewhere starts where the refit put it.
        """
        starts, evidence = list(self.catalogue[name]), self.evidence.get("chassis")
        if name == COG and base.vehicle.l_f != self.vehicle.l_f:
            return [replace(starts[0], **{"offset": self.vehicle.l_f - base.vehicle.l_f})]
        if not placed(name) or evidence is None or not {"x", "y"} <= set(evidence.columns):
            return starts
        found = base if "chassis" in base.initial else self.base
        errors, noise = self.errors(found)["chassis"], self.noise["chassis"]
        return [replace(starts[0], **{"x": x, "y": y}) for x, y in places(evidence, errors, noise, REACH, PLACES)]

    def beyond(self, base: Found, stages: Iterable[str]) -> float:
        """Return a fit's cost in some stages, in that of the noise: far above 1 the parameters may be astray."""
        names = list(stages)
        return float(sum(self.cost(base, n).sum() for n in names) / sum(self.floor[n] for n in names))

    def scores(self, base: Found) -> dict[str, Score]:
        """Return the score of every effect that a fitted vehicle lacks, per stage."""
        start = self._start(base, self.evidence)
        found = {}
        for name, evidence in self.evidence.items():
            known = self._known_elsewhere([name])
            unknowns = [u for u in self._unknowns(base.effects, base.vehicle) if u.name not in known]
            problem = StageProblem.of(
                evidence, self.kernels[name], base.vehicle, unknowns, self.sigma[name], whole=True
            )
            found[name] = score(problem, unknowns, base.theta, _begun(problem, start.initial, None))
        return found

    def score(self, base: Found) -> Score:
        """Return the scores summed over the stages."""
        return summed(self.scores(base).values())

    def add(self, base: Found, name: str, vehicle: Vehicle) -> Found:
        """Fit a vehicle with an effect more than a fitted one has, over the stages that they touch."""
        effects = base.effects | {name}
        stages = self.touched(vehicle, effects)
        return self._fit(effects, vehicle, self._start(base, stages), REFINE, stages)

    def converged(self, found: Found) -> Found:
        """Return a fit carried on to its end."""
        if found.fit.converged:
            return found
        return self._settled(found.effects, found.vehicle, found, stages=list(found.cost))

    def again(self, found: Found, changes: Mapping[str, float]) -> Found:
        """Return a fit over the same stages that starts from a fitted vehicle with some values changed."""
        vehicle = replace_values(found.vehicle, changes)
        return self._fit(found.effects, vehicle, found, NOMINAL, list(found.cost))

    def expected(self, found: Found) -> dict[str, Array]:
        """Return the errors (T + 1, C, W) per stage that sensors' noise alone would leave in a right vehicle."""
        return {
            (name := stage.evidence.stage.name): expected_errors(
                stage, found.theta, initial, self.noise[name], self.seed
            )
            for stage, initial in zip(found.problem.stages, found.fit.initial, strict=True)
        }

    def noise_cost(self, found: Found) -> dict[str, float]:
        """Return the cost per stage that sensors' noise alone would leave if a fitted vehicle were right."""
        if found not in self._noise_cost:
            key = self.checkpoint.key("noise", found.key, self.noise, self.seed)
            parts = self.checkpoint.recall(
                key, lambda: {name: np.array([part]) for name, part in self._squares(self.expected(found)).items()}
            )
            self._noise_cost[found] = {name: float(parts[name][0]) for name in found.cost}
        return self._noise_cost[found]

    def _squares(self, errors: Mapping[str, Array]) -> dict[str, float]:
        """Return the summed cost per stage; a window in which noise makes the vehicle spin counts up to a limit."""
        costs = {name: ((part / self.sigma[name][:, None]) ** 2).sum(axis=(0, 1)) for name, part in errors.items()}
        return {name: float(np.minimum(part, CALM * np.median(part)).sum()) for name, part in costs.items()}

    def everywhere(self, found: Found) -> Found:
        """Identify all parameters again, over all stages, with the effects of a fit."""
        names = list(self.evidence)
        return self._settled(found.effects, found.vehicle, self._start(found, names), stages=names)

    def without(self, base: Found, name: str) -> Found:
        """Fit a vehicle that lacks one effect of a fitted one, over the same stages."""
        others = {key: effect for key, effect in base.vehicle.effects.items() if key != name}
        vehicle = replace(base.vehicle, effects=others)
        return self._settled(base.effects - {name}, vehicle, self._start(base, base.cost), stages=base.cost)

    def _start(self, base: Found, stages: Iterable[str]) -> Found:
        missing = {name: self.base.initial[name] for name in stages if name not in base.initial}
        return replace(base, initial={**base.initial, **missing})

    def cost(self, found: Found, stage: str) -> Array:
        """Return a fit's cost per window of a stage; the nominal one where its effects do not touch it."""
        return found.cost.get(stage, self.base.cost[stage])

    def blocks(self, stage: str) -> NDArray[np.int64]:
        """Return a number per window of a stage: neighbours of one run that are held out, and resampled, together."""
        evidence = self.evidence[stage]
        stretch = evidence.run * 1_000_000 + evidence.start // (STRETCH * evidence.length)
        return np.unique(stretch, return_inverse=True)[1]

    def _deal(self, count: int) -> list[dict[str, NDArray[np.bool_]]]:
        """Return masks of the windows that each fold holds out: stretches of a few seconds, dealt in turn.

        So every manoeuvre is in all folds; whole runs would leave what only one of them excites to chance.
        """
        turn = {name: self.blocks(name) % count for name in self.evidence}
        return [{name: number == fold for name, number in turn.items()} for fold in range(count)]

    def held_out(self, found: Found) -> dict[str, Array]:
        """Return the cost of every window under parameters that have not seen its fold, per stage."""
        if found not in self._held_out:
            names = list(found.cost)
            folds = [[fold[name] for name in names] for fold in self.folds]
            parts = self.checkpoint.recall(
                self.checkpoint.key("held out", found.key, folds),
                lambda: dict(zip(names, found.problem.held_out(found.fit, folds), strict=True)),
            )
            self._held_out[found] = {name: parts[name] for name in names}
        return self._held_out[found]

    def errors(self, found: Found) -> dict[str, Array]:
        """Return simulated − measured (T + 1, C, W) per stage under a fit as it is."""
        return {
            stage.evidence.stage.name: stage.errors(found.theta, initial)
            for stage, initial in zip(found.problem.stages, found.fit.initial, strict=True)
        }

    def held_out_errors(self, found: Found) -> dict[str, Array]:
        """Return simulated − measured (T + 1, C, W) per stage, likewise."""
        names = list(found.cost)
        errors = found.problem.held_out_errors(found.fit, [[fold[name] for name in names] for fold in self.folds])
        return dict(zip(names, errors, strict=True))

    def deviations(self, found: Found) -> dict[str, float]:
        """Return the standard deviation of every parameter of a fit.

        How far the centre of gravity is from where it was weighed is known no better than it was weighed.
        """

        def variances() -> Parts:
            covariance = found.problem.covariance(found.fit, [self.blocks(name) for name in found.cost])
            return {"variances": np.diag(covariance)}

        parts = self.checkpoint.recall(self.checkpoint.key("variances", found.key), variances)
        deviations = np.sqrt(np.maximum(parts["variances"], 0.0))
        known = dict(zip(found.problem.names, deviations.tolist(), strict=True))
        offset, weighed = f"effects.{COG}.offset", {u.name: u.sigma for u in self.unknowns}.get("l_f", 0.0)
        return {**known, offset: float(np.hypot(known[offset], weighed))} if offset in known else known

    def moved(self) -> list[dict[str, Any]]:
        """Return the vehicle's parameters that the refit took far from where they were configured, or to a bound."""
        rows = []
        for unknown in self.base.problem.unknowns:
            value = self.base.theta[unknown.name]
            bound = value in (unknown.low, unknown.high)
            if bound or abs(value - unknown.start) > FAR * unknown.sigma:
                rows.append({"name": unknown.name, "configured": unknown.start, "refitted": value, "at_bound": bound})
        return rows

    def outcome(self, evidence: Evidence, seed: int) -> tuple[Array, Array]:
        """Return the errors (T + 1, C, W) of the refitted vehicle over a stage that was not fitted, and the noise's."""
        noise = evidence.noise()
        kernels = StageKernels(evidence, self.base.vehicle, [], {})
        stage = StageProblem.of(evidence, kernels, self.base.vehicle, [], noise)
        (initial,) = Problem([stage], []).fit({}, iterations=REFINE).initial
        return stage.errors({}, initial), expected_errors(stage, {}, initial, noise, seed)

    def unfitted(self) -> Found:
        """Return the vehicle as configured, with initial states fitted only."""
        return self._fit(frozenset(), self.vehicle, self.base, REFINE, free=())


def _sampled(evidence: Mapping[str, Evidence]) -> dict[str, NDArray[np.int64]]:
    """Return a share of each stage's windows."""
    return {name: np.arange(len(each.start))[::SAMPLED] for name, each in evidence.items()}


def _begun(
    stage: StageProblem, initial: Mapping[str, Mapping[str, Array]], index: Mapping[str, NDArray[np.int64]] | None
) -> Array:
    """Return where a stage's windows, or some of them, began in an earlier fit (S, W); nan for states it lacked."""
    name = stage.evidence.stage.name
    known, lacking = initial[name], np.full(len(stage.evidence.start), np.nan)
    rows = np.array([known.get(state, lacking) for state in stage.rollout.vehicle.states])
    return rows if index is None else rows[:, index[name]]


def with_effect(vehicle: Vehicle, name: str, effect: Effect) -> Vehicle:
    """Return a vehicle with an effect more."""
    return replace(vehicle, effects={**vehicle.effects, name: effect})
