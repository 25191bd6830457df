"""A nominal that can be any tyre: where held-out windows ask for it, the refit's tyre deviates from its formula.

Another formula is a tyre's shape then, and no effect. Effects depend on time, place, side, speed or load, and stay.
"""

from collections.abc import Sequence
from dataclasses import fields, replace

import numpy as np
from numpy.typing import NDArray

from racerl.estimation.unknowns import Unknown
from racerl.gap.comparison import PARAMETER, REAL, CandidateScore, Judge, excesses
from racerl.gap.decision import Decision
from racerl.gap.fit_data import kernels_of
from racerl.gap.fitted_model import FittedModel, better_half_way, settled_fit, touched, with_effect
from racerl.gap.investigation import SHAPE, Investigation, investigation_of
from racerl.gap.nominal import Nominal
from racerl.gap.stage import TYRES
from racerl.vehicle.effects.tyre_shape import TyreShape
from racerl.vehicle.parameter import specifications, values
from racerl.vehicle.vehicle import Vehicle

Array = NDArray[np.float64]
SIZE = len(fields(TyreShape)) - len(TyreShape.known)  # weights
MOST = 0.5  # share of what is left that a shape must explain
SPREAD = 0.5  # deviation of the weights' priors
LARGE = 0.4  # of D/K, from which on a slip counts as large: where formulas differ (one simulated car on Dugoff tyres)


def other_tyre(judge: Judge, decision: Decision, rows: Sequence[CandidateScore]) -> Investigation | None:
    """Return the investigation on a tyre of any shape where that comes before a round's candidates; else None.

    The shape is a candidate that must explain most of what is left or, beside effects found, its weights' shares of the
    first excess: by itself it would take a part of an effect that has no name. It is not fitted beside an effect that
    it cannot come before.
    """
    plain = judge.investigation
    if plain.shaped or TYRES not in decision.cost:
        return None
    best = [row for row in rows[:1] if row.needed]
    if not best and excesses(plain, decision.cost, decision.noise)[TYRES] < REAL * decision.noise[TYRES]:
        return None
    if any(TYRES not in row.cost or row.explained > 1.0 - PARAMETER * (SIZE - row.size) for row in best):
        return None
    shaped = _with_weights(plain)
    model = _fitted(shaped, decision.found)
    row = replace(judge, investigation=shaped).score(SHAPE, model, decision)
    worth = bool(decision.chosen) and row.worth >= PARAMETER * SIZE
    if not row.clear or not (worth or row.explained >= MOST):
        return None
    if judge.ranked([*best, row], decision.cost)[0].name != SHAPE:
        return None
    return _settled(shaped, model if not decision.chosen else _fitted(shaped, plain.base))


def shape_of(found: FittedModel) -> list[str]:
    """Return the name of the tyre's shape if a fitted vehicle has one that is not the formula's."""
    weights = [value for name, value in found.theta.items() if name in _weights(found.vehicle)]
    return [SHAPE] if any(weights) else []


def _weights(vehicle: Vehicle) -> list[str]:
    fixed = {f"effects.{SHAPE}.{name}" for name in TyreShape.known}
    return [name for name in specifications(vehicle) if name.startswith(f"effects.{SHAPE}.") and name not in fixed]


def _with_weights(plain: Investigation) -> Investigation:
    """Return the investigation of a vehicle with a shape, zero yet, its weights among the unknowns."""
    vehicle = with_effect(plain.vehicle, SHAPE, TyreShape(**_slips(plain.vehicle)))
    known = specifications(vehicle)
    weights = [Unknown(name, 0.0, SPREAD, known[name].low, known[name].high) for name in _weights(vehicle)]
    unknowns = [*plain.unknowns, *weights]
    kernels = kernels_of(plain.evidence, vehicle, unknowns, plain.catalogue)
    return replace(plain, vehicle=vehicle, unknowns=unknowns, kernels=kernels)


def _fitted(shaped: Investigation, found: FittedModel) -> FittedModel:
    """Return a fit of the shape from where a fit without it stands, over the stages that they touch."""
    vehicle = with_effect(found.vehicle, SHAPE, shaped.vehicle.effects[SHAPE])
    stages = [TYRES, *touched(shaped, vehicle, found.effects)] if found.effects else list(shaped.evidence)
    fitted = settled_fit(shaped, found.effects, vehicle, found, stages=list(dict.fromkeys(stages)))
    return better_half_way(shaped, fitted)


def _settled(shaped: Investigation, model: FittedModel) -> Investigation:
    """Return the investigation by a nominal fit with the shape."""
    data = replace(shaped, strength=model.strength)
    return investigation_of(data, Nominal(model, shaped.nominal.met_twice), shaped.folds, shaped.seed)


def _slips(vehicle: Vehicle) -> dict[str, float]:
    """Return the slips that are large: a share of those at which forces that rise in a straight line reach the peak."""
    table = values(vehicle)
    slip = {
        key: np.mean([table[f"{axle}.p_D{way}1"] / table[f"{axle}.p_K{way}1"] for axle in ("front", "rear")])
        for key, way in (("kappa", "x"), ("alpha", "y"))
    }
    return {key: float(LARGE * table["friction"] * each) for key, each in slip.items()}
