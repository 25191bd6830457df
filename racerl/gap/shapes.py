"""What the refit's vehicle may be that is no effect: a double track, on tyres of any formula.

Every car has two wheels on an axle, and hardly any tyre is the Magic Formula. Where held-out windows ask for such a
shape it belongs to the vehicle, and naming begins anew with it. Effects depend on time, place, side, load or history.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from racerl.estimation.unknowns import Unknown
from racerl.gap.comparison import ALL, EQUAL, PARAMETER, REAL, CandidateScore, Judge, equals, excesses
from racerl.gap.decision import Decision
from racerl.gap.fit_data import kernels_of
from racerl.gap.fitted_model import FittedModel, better_half_way, settled_fit, touched, with_effect
from racerl.gap.investigation import DOUBLE_TRACK, TYRE_SHAPE, Investigation, investigation_of
from racerl.gap.nominal import Nominal
from racerl.gap.stage import TYRES
from racerl.vehicle.effects import Effect
from racerl.vehicle.effects.double_track import DoubleTrack
from racerl.vehicle.effects.tyre_shape import TyreShape
from racerl.vehicle.parameter import replace_values, specifications, values
from racerl.vehicle.vehicle import Vehicle

Array = NDArray[np.float64]
MOST = 0.5  # share of what is left that another tyre must explain
SPREAD = 0.5  # deviation of the priors of a tyre shape's weights, and of Ackermann's share
LARGE = 0.4  # of D/K, from which on a slip counts as large: where formulas differ (one simulated car on Dugoff tyres)
WIDTH, VARIED = 0.6, 0.2  # of the wheelbase: a usual track width, and its deviation


@dataclass(frozen=True)
class Shape:
    """One such shape, in `words`: as it is where it changes nothing, and its unknowns, which start from usual values.

    `least` is the share of what is left that it must explain to come first, and `common`: as well as others is enough.
    """

    name: str
    words: str
    neutral: Callable[[Vehicle], Effect]
    unknowns: Callable[[Vehicle], list[Unknown]]
    least: float
    common: bool


@dataclass(frozen=True, eq=False)
class Trial:
    """A fit of a vehicle with further shapes, judged as a candidate; the rules are those of the last one of them."""

    investigation: Investigation
    shape: Shape
    unknowns: list[Unknown]
    found: FittedModel
    row: CandidateScore


def other_shape(judge: Judge, decision: Decision, rows: Sequence[CandidateScore]) -> Investigation | None:
    """Return the investigation of a vehicle of another shape where that comes before a round's candidates; else None.

    A shape is a candidate that must explain its least share of what is left or, beside effects found, its parameters'
    shares of the first excess: by itself a tyre would take a part of an effect that has no name. It is not fitted
    beside an effect that it cannot come before. A tyre that helps, but not enough, may do so on a double track.
    """
    plain = judge.investigation
    if TYRES not in decision.cost:
        return None
    best = [row for row in rows[:1] if row.needed]
    if not best and not _gap(judge, decision):
        return None
    for trial in _trials(judge, decision, best):
        if _comes_before(judge, decision, best, trial):
            return _settled(_with_more(judge, decision, trial), plain.base if decision.chosen else None)
    return None


def _gap(judge: Judge, decision: Decision) -> bool:
    """Return whether more than noise is left where tyres act."""
    left = excesses(judge.investigation, decision.cost, decision.noise)[TYRES]
    return left >= REAL * decision.noise[TYRES]


def _with_more(judge: Judge, decision: Decision, trial: Trial) -> Trial:
    """Return the trial, or one with a further shape that it asks for: so naming begins anew once, and not twice.

    No effect is tried beside it there, so that it has to explain more than a part of one.
    """
    further = _further(judge, decision, trial)
    return next((more for more in further if more.row.clear and more.row.explained >= ALL), trial)


def _further(judge: Judge, decision: Decision, trial: Trial) -> Iterator[Trial]:
    """Fit what a trial lacks from where it stands, which may have made up for that, and then both at once."""
    cost = {**decision.cost, **trial.row.cost}
    inside, after = replace(judge, investigation=trial.investigation), replace(decision, found=trial.found, cost=cost)
    if not _lacking(inside) or not _gap(inside, after):
        return
    for more in _trials(inside, after, []):
        yield replace(more, unknowns=[*trial.unknowns, *more.unknowns])
    both = _trial(judge, replace(decision, cost=cost), [], _lacking(judge))
    if both is not None:
        yield both


def _trials(judge: Judge, decision: Decision, best: Sequence[CandidateScore]) -> Iterator[Trial]:
    """Fit one after another the shapes that the vehicle lacks, and all of them if the last one helps."""
    new, trial = _lacking(judge), None
    for shape in new:
        trial = _trial(judge, decision, best, [shape])
        if trial is not None:
            yield trial
    if len(new) > 1 and trial is not None and trial.row.clear:
        trial = _trial(judge, decision, best, new)
        if trial is not None:
            yield trial


def _lacking(judge: Judge) -> list[Shape]:
    return [shape for shape in SHAPES if shape.name not in judge.investigation.vehicle.effects]


def _trial(judge: Judge, decision: Decision, best: Sequence[CandidateScore], shapes: Sequence[Shape]) -> Trial | None:
    """Return a fit with these shapes beside the effects found; None where it cannot come before the best candidate."""
    plain, name = judge.investigation, shapes[-1].name
    unknowns = [unknown for shape in shapes for unknown in shape.unknowns(plain.vehicle)]
    for row in best:
        if TYRES not in row.cost or row.explained > 1.0 - max(EQUAL, PARAMETER * (len(unknowns) - row.size)):
            return None
    shaped = _with(plain, shapes, unknowns)
    found = _fitted(shaped, decision.found, unknowns)
    row = replace(judge, investigation=shaped).score(name, found, decision)
    return Trial(shaped, shapes[-1], unknowns, found, replace(row, more=len(unknowns) - row.size))


def _comes_before(judge: Judge, decision: Decision, best: Sequence[CandidateScore], trial: Trial) -> bool:
    """Return whether a vehicle of another shape explains enough, and more than the best candidate of a round."""
    row, shape = trial.row, trial.shape
    worth = bool(decision.chosen) and row.worth >= PARAMETER * len(trial.unknowns)
    if not row.clear or not (worth or row.explained >= shape.least):
        return False
    first, *others = judge.ranked([*best, row], decision.cost)
    alike = equals([first, *others]) if shape.common else []
    return shape.name in (each.name for each in (first, *alike))


def shapes_of(found: FittedModel) -> list[str]:
    """Return the names of the shapes that change a fitted vehicle."""
    return [shape.name for shape in SHAPES if shape.name in found.vehicle.effects and _changes(shape, found.vehicle)]


def said_of(name: str, found: FittedModel) -> str:
    """Return what a fitted vehicle's shape is, in words."""
    apart = f", {found.theta[f'effects.{name}.track_width']:.2g} m apart" if name == DOUBLE_TRACK else ""
    return f"{WORDS[name]}{apart}"


def in_order(effects: Mapping[str, Any]) -> dict[str, Any]:
    """Return effects by name with the shapes behind all others: a tyre's shape acts on what two wheels do together."""
    last = [shape.name for shape in SHAPES if shape.name in effects]
    return {name: effects[name] for name in (*(name for name in effects if name not in last), *last)}


def _changes(shape: Shape, vehicle: Vehicle) -> bool:
    own, neutral = vehicle.effects[shape.name], shape.neutral(vehicle)
    free = [field.name for field in fields(neutral) if field.name not in own.known]
    return any(getattr(own, name) != getattr(neutral, name) for name in free[: own.vanishing])


def _with(plain: Investigation, shapes: Sequence[Shape], unknowns: Sequence[Unknown]) -> Investigation:
    """Return the investigation of a vehicle with shapes that change nothing yet, and their unknowns."""
    vehicle = plain.vehicle
    for shape in shapes:
        vehicle = with_effect(vehicle, shape.name, shape.neutral(plain.vehicle))
    vehicle = replace(vehicle, effects=in_order(vehicle.effects))
    every = [*plain.unknowns, *unknowns]
    kernels = kernels_of(plain.evidence, vehicle, every, plain.catalogue)
    return replace(plain, vehicle=vehicle, unknowns=every, kernels=kernels)


def _fitted(shaped: Investigation, found: FittedModel, unknowns: Sequence[Unknown]) -> FittedModel:
    """Return a fit of the shape from where a fit without it stands, over the stages that they touch."""
    vehicle = replace(found.vehicle, effects=in_order({**shaped.vehicle.effects, **found.vehicle.effects}))
    vehicle = replace_values(vehicle, {unknown.name: unknown.start for unknown in unknowns})
    stages = [TYRES, *touched(shaped, vehicle, found.effects)] if found.effects else list(shaped.evidence)
    fitted = settled_fit(shaped, found.effects, vehicle, found, stages=list(dict.fromkeys(stages)))
    return better_half_way(shaped, fitted)


def _settled(trial: Trial, base: FittedModel | None) -> Investigation:
    """Return the investigation by a nominal fit with the shapes: the trial's, or one from a fit without effects."""
    shaped = trial.investigation
    model = trial.found if base is None else _fitted(shaped, base, trial.unknowns)
    data = replace(shaped, strength=model.strength)
    return investigation_of(data, Nominal(model, shaped.nominal.met_twice), shaped.folds, shaped.seed)


def _formula(vehicle: Vehicle) -> TyreShape:
    """Return the formula's own shape; large are slips from a share of where straight lines reach the peak."""
    table, slips = values(vehicle), {}
    for axle in ("front", "rear"):
        for slip, way in (("kappa", "x"), ("alpha", "y")):
            reached = table["friction"] * table[f"{axle}.p_D{way}1"] / table[f"{axle}.p_K{way}1"]
            slips[f"{slip}_{axle[0]}"] = LARGE * float(reached)
    return TyreShape(**slips)


def _weights(vehicle: Vehicle) -> list[Unknown]:
    known = specifications(with_effect(vehicle, TYRE_SHAPE, _formula(vehicle)))
    names = [name for name in known if name.startswith(f"effects.{TYRE_SHAPE}.")]
    free = [name for name in names if name.rpartition(".")[2] not in TyreShape.known]
    return [Unknown(name, 0.0, SPREAD, known[name].low, known[name].high) for name in free]


def _single_track(vehicle: Vehicle) -> DoubleTrack:
    return DoubleTrack(track_width=0.0)


def _wheels(vehicle: Vehicle) -> list[Unknown]:
    """Return track width and Ackermann's share; a car is no wider than long."""
    wheelbase, key = float(vehicle.wheelbase), f"effects.{DOUBLE_TRACK}"
    return [
        Unknown(f"{key}.track_width", WIDTH * wheelbase, VARIED * wheelbase, 0.0, wheelbase),
        Unknown(f"{key}.ackermann", 0.5, SPREAD, 0.0, 1.0),
    ]


SHAPES = (
    Shape(DOUBLE_TRACK, "two wheels on an axle", _single_track, _wheels, 0.0, common=True),
    Shape(TYRE_SHAPE, "a tyre shape that departs from its formula", _formula, _weights, MOST, common=False),
)
WORDS = {shape.name: shape.words for shape in SHAPES}
