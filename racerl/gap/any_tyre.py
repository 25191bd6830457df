"""A nominal that can be any tyre: where held-out windows ask for it, the refit's tyre deviates from its formula.

Another formula is a tyre's shape then, and no effect. Effects depend on time, place, side, speed or load, and stay.
"""

from dataclasses import fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from racerl.estimation.unknowns import Unknown
from racerl.gap.comparison import CLEAR, REAL, Judge, excesses
from racerl.gap.cross_validation import held_out, held_out_errors
from racerl.gap.fit_data import FitData, kernels_of
from racerl.gap.fitted_model import FittedModel, settled_fit, with_effect
from racerl.gap.investigation import Investigation, investigation_of
from racerl.gap.nominal import NOTHING, Nominal
from racerl.vehicle.effects.tyre_shape import TyreShape
from racerl.vehicle.parameter import specifications, values
from racerl.vehicle.vehicle import Vehicle

Array = NDArray[np.float64]
SHAPE, STAGE = "tyre_shape", "chassis"
SPREAD = 0.5  # deviation of the weights' priors
LARGE = 0.4  # of D/K, from which on a slip counts as large: where formulas differ (one simulated car on Dugoff tyres)


def any_tyre(plain: Investigation) -> Investigation:
    """Return the investigation with a tyre of any shape if that is asked for, else as it is."""
    if SHAPE in plain.vehicle.effects:
        return replace(plain, shaped=True)
    if STAGE not in plain.evidence:
        return plain
    cost = held_out(plain, plain.base)
    if excesses(plain, cost, plain.floor)[STAGE] < REAL * plain.floor[STAGE]:
        return plain
    shaped = _shaped(plain)
    errors = held_out_errors(shaped, shaped.base)[STAGE] / plain.sigma[STAGE][:, None]
    other = {STAGE: (errors**2).sum(axis=(0, 1))}
    gain, error = Judge(plain, cost).gain({STAGE: cost[STAGE]}, other)
    return shaped if gain > CLEAR * error else plain


def shape_of(found: FittedModel) -> list[str]:
    """Return the name of the tyre's shape if a fitted vehicle has one that is not the formula's."""
    weights = [value for name, value in found.theta.items() if name in _weights(found.vehicle)]
    return [SHAPE] if any(weights) else []


def _weights(vehicle: Vehicle) -> list[str]:
    fixed = {f"effects.{SHAPE}.{name}" for name in TyreShape.known}
    return [name for name in specifications(vehicle) if name.startswith(f"effects.{SHAPE}.") and name not in fixed]


def _shaped(plain: Investigation) -> Investigation:
    """Return the investigation with the shape's weights among the unknowns, fitted from where it stands."""
    shape = TyreShape(**_slips(plain.vehicle))
    vehicle = with_effect(plain.vehicle, SHAPE, shape)
    known = specifications(vehicle)
    weights = [Unknown(name, 0.0, SPREAD, known[name].low, known[name].high) for name in _weights(vehicle)]
    unknowns = [*plain.unknowns, *weights]
    given: dict[str, Any] = {field.name: getattr(plain, field.name) for field in fields(FitData)}
    kernels = kernels_of(plain.evidence, vehicle, unknowns, plain.catalogue)
    data = FitData(**{**given, "vehicle": vehicle, "unknowns": unknowns, "kernels": kernels})
    model = settled_fit(data, NOTHING, with_effect(plain.base.vehicle, SHAPE, shape), plain.base)
    nominal = Nominal(model, plain.nominal.met_twice)
    found = investigation_of(replace(data, strength=model.strength), nominal, plain.folds, plain.seed)
    return replace(found, shaped=True)


def _slips(vehicle: Vehicle) -> dict[str, float]:
    """Return the slips that are large: a share of those at which forces that rise in a straight line reach the peak."""
    table = values(vehicle)
    slip = {
        key: np.mean([table[f"{axle}.p_D{way}1"] / table[f"{axle}.p_K{way}1"] for axle in ("front", "rear")])
        for key, way in (("kappa", "x"), ("alpha", "y"))
    }
    return {key: float(LARGE * table["friction"] * each) for key, each in slip.items()}
