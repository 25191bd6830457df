"""Fitted models: a vehicle with some effects, fitted to every stage that they touch.

Stages that no effect of a set touches keep the nominal fit, so that sets are compared by what they change.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from racerl.estimation.pseudo_huber import pseudo_huber
from racerl.estimation.unknowns import Unknown
from racerl.gap.fit_data import FitData
from racerl.gap.problem import Fit, Problem
from racerl.gap.stage_problem import StageProblem
from racerl.vehicle.effects import Effect
from racerl.vehicle.parameter import replace_values, specifications, values
from racerl.vehicle.vehicle import Vehicle

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Names = frozenset[str]
ROUNDS, SETTLED = 4, 1.5  # most fits with the priors' strength set anew, until it changes by less than this factor
LONGEST = 60  # most steps of a fit that is to end in a minimum
COG = "cog_longitudinal_offset"  # takes the place of l_f, which is then as weighed
AXLES = ("front.", "rear.")  # parameters of tyres
WIDE = 3.0  # deviation of an effect's parameters, in their usual sizes


@dataclass(eq=False)
class FittedModel:
    """The best fit of a vehicle with some effects.

    `cost` (W,) of the stages that it was fitted to; `initial` states and the priors' `strength` λ of all stages.
    """

    effects: Names
    vehicle: Vehicle  # with the fitted values
    theta: dict[str, float]
    initial: dict[str, dict[str, Array]]
    cost: dict[str, Array]
    strength: dict[str, float]  # that every stage's residuals ask for
    fit: Fit
    problem: Problem
    key: str  # of all that it came from

    @property
    def strain(self) -> float:
        """What its parameters cost for being away from where the priors have them."""
        return self.problem.prior(np.array([self.theta[name] for name in self.problem.names]))

    def errors(self) -> dict[str, Array]:
        """Return simulated − measured (T + 1, C, W) per stage that it was fitted to."""
        return {
            stage.evidence.stage.name: stage.errors(self.theta, initial)
            for stage, initial in zip(self.problem.stages, self.fit.initial, strict=True)
        }


def fit_model(
    data: FitData,
    effects: Names,
    vehicle: Vehicle,
    start: FittedModel | None,
    iterations: int,
    *,
    stages: Iterable[str] | None = None,
    index: Mapping[str, Index] | None = None,
    free: Sequence[Unknown] | None = None,
    strength: Mapping[str, float] | None = None,
) -> FittedModel:
    """Fit a vehicle to all windows of some stages (all unless given), or to those of `index`.

    It starts from the vehicle's values and from the initial states of `start`; the priors are as strong as `start` asks
    for unless given. `free`: all that may change.
    """
    names = list(data.evidence if stages is None else stages)
    carried = {**data.strength, **(start.strength if start else {})}
    unknowns = unknowns_with(data, effects, vehicle) if free is None else free
    if start is not None and set(names) < set(data.evidence):
        known = data.known_elsewhere(names)
        unknowns = [unknown for unknown in unknowns if unknown.name not in known]
    problem = Problem(
        [StageProblem.of(data.evidence[n], data.kernels[n], vehicle, unknowns, data.sigma[n]) for n in names],
        unknowns,
        [(strength or carried)[name] for name in names],
    )
    table = {name: float(value) for name, value in values(vehicle).items()}
    initial = None if start is None else [begun(stage, start.initial, index) for stage in problem.stages]
    chosen = None if index is None else [index[name] for name in names]
    fit, key = _fit(data, problem, {name: table[name] for name in problem.names}, initial, chosen, iterations)
    fitted = replace_values(vehicle, fit.theta)
    own = {
        name: dict(zip(stage.rollout.vehicle.states, rows, strict=True))
        for name, stage, rows in zip(names, problem.stages, fit.initial, strict=True)
    }
    return FittedModel(
        effects,
        fitted,
        {name: float(value) for name, value in values(fitted).items()},
        {**(start.initial if start else {}), **own},
        dict(zip(names, fit.cost, strict=True)),
        {**carried, **dict(zip(names, fit.strength, strict=True))},
        fit,
        problem,
        key,
    )


def _fit(
    data: FitData,
    problem: Problem,
    theta: dict[str, float],
    initial: Sequence[Array] | None,
    chosen: Sequence[Index] | None,
    iterations: int,
) -> tuple[Fit, str]:
    """Return a fit, from the checkpoint where it is finished there, and its key."""
    key = data.checkpoint.key("fit", problem.told(), theta, initial, chosen, iterations)

    def worked_out() -> Fit:
        data.workers.go_on()
        return problem.fit(theta, initial, chosen, iterations)

    if (parts := data.checkpoint.find(key)) is not None:
        return Fit.of(parts, problem.names, lambda: worked_out().lines), key
    fit = worked_out()
    data.checkpoint.keep(key, fit.parts())
    return fit, key


def settled_fit(
    data: FitData,
    effects: Names,
    vehicle: Vehicle,
    start: FittedModel | None,
    *,
    stages: Iterable[str] | None = None,
    index: Mapping[str, Index] | None = None,
    strength: Mapping[str, float] | None = None,
) -> FittedModel:
    """Fit until the priors are as strong as what the fit leaves asks for."""
    for _ in range(ROUNDS):
        found = fit_model(data, effects, vehicle, start, LONGEST, stages=stages, index=index, strength=strength)
        given, asked = found.problem.strength, found.fit.strength
        if all(1.0 / SETTLED < new / old < SETTLED for new, old in zip(asked, given, strict=True)):
            break
        vehicle, strength = found.vehicle, found.strength
        start = found if index is None else None
    return found


def loss(data: FitData, found: FittedModel) -> float:
    """Return the loss of a fit, its priors apart, n the noise's cost; infinite where a window blew up."""
    parts = (float(pseudo_huber(part, data.evidence[name].numbers).sum()) for name, part in found.cost.items())
    return float(np.nan_to_num(sum(parts), nan=np.inf))


def better(data: FitData, *fits: FittedModel) -> FittedModel:
    """Return the best of some fits of one vehicle with its priors."""
    return min(fits, key=lambda each: loss(data, each) + each.strain)


def better_half_way(data: FitData, found: FittedModel) -> FittedModel:
    """Return the better one of a fit and of one that starts half of the way back to the tyres as configured.

    The formula's coefficients had made up for what the vehicle lacked before, and small steps do not undo that.
    """
    configured = {name: float(value) for name, value in values(data.vehicle).items()}
    free = [name for name in found.problem.names if name.startswith(AXLES)]
    between = {name: 0.5 * (found.theta[name] + configured[name]) for name in free}
    if not between:
        return found
    vehicle = replace_values(found.vehicle, between)
    return better(data, found, settled_fit(data, found.effects, vehicle, found, stages=list(found.cost)))


def begun(stage: StageProblem, initial: Mapping[str, Mapping[str, Array]], index: Mapping[str, Index] | None) -> Array:
    """Return where a stage's windows, or some of them, began in an earlier fit (S, W); nan for states it lacked."""
    name = stage.evidence.stage.name
    known, lacking = initial[name], np.full(len(stage.evidence.start), np.nan)
    rows = np.array([known.get(state, lacking) for state in stage.rollout.vehicle.states])
    return rows if index is None else rows[:, index[name]]


def unknowns_with(data: FitData, effects: Names, vehicle: Vehicle) -> list[Unknown]:
    """Return what a fit of a vehicle with some effects may change."""
    nominal = [unknown for unknown in data.unknowns if unknown.name != "l_f" or COG not in effects]
    return [*nominal, *(unknown for name in sorted(effects) for unknown in _free(data, vehicle, name))]


def _free(data: FitData, vehicle: Vehicle, effect: str) -> list[Unknown]:
    """Return an effect's parameters as unknowns, with wide priors, inside physical bounds or the log's own."""
    own = vehicle.effects[effect]
    if not own.physical:  # what is learned has its prior where it started, whatever it has become
        vehicle = with_effect(vehicle, effect, type(own)())
    table, known = values(vehicle), specifications(vehicle)
    names = [n for n in table if n.startswith(f"effects.{effect}.") and n.rpartition(".")[2] not in own.known]
    return [
        Unknown(
            name,
            float(table[name]),
            WIDE * max(abs(float(table[name])), 0.01 * min(1.0, known[name].high - known[name].low)),
            *data.limits.get(name, (known[name].low, known[name].high)),
            effect=True,
        )
        for name in names
    ]


def touched(data: FitData, vehicle: Vehicle, effects: Iterable[str]) -> list[str]:
    """Return the stages whose outcome depends on a parameter of the effects."""
    return stages_with(data, vehicle, [unknown for effect in effects for unknown in _free(data, vehicle, effect)])


def stages_with(data: FitData, vehicle: Vehicle, unknowns: Sequence[Unknown]) -> list[str]:
    """Return the stages whose outcome depends on any of the unknowns."""
    return [
        name
        for name, evidence in data.evidence.items()
        if StageProblem.touched(evidence, data.kernels[name], vehicle, unknowns)
    ]


def with_effect(vehicle: Vehicle, name: str, effect: Effect) -> Vehicle:
    """Return a vehicle with an effect more."""
    return replace(vehicle, effects={**vehicle.effects, name: effect})
