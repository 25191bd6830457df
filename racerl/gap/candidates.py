"""Fits of candidates: a fitted model with an effect more, with one less, or with everything identified again."""

from collections.abc import Mapping
from dataclasses import replace

from racerl.gap.fit_data import FitData
from racerl.gap.fitted_model import (
    COG,
    LONGEST,
    FittedModel,
    better,
    fit_model,
    settled_fit,
    touched,
    unknowns_with,
    with_effect,
)
from racerl.gap.investigation import Investigation
from racerl.vehicle.effects import Effect
from racerl.vehicle.parameter import replace_values
from racerl.vehicle.vehicle import Vehicle

FIRST = 6  # steps of a candidate's first fit
RESTING = 8  # most steps of initial states alone


def joined(data: FitData, vehicle: Vehicle, name: str, effect: Effect) -> Vehicle:
    """Return a fitted vehicle with an effect more; a displaced centre of gravity starts from l_f as weighed."""
    more = with_effect(vehicle, name, effect)
    return replace_values(more, {"l_f": data.vehicle.l_f}) if name == COG else more


def add(investigation: Investigation, base: FittedModel, name: str, vehicle: Vehicle) -> FittedModel:
    """Fit a vehicle with an effect more than a fitted one has, over the stages that they touch, for a few steps.

    Where that ends above the fit that it began beside, its other parameters went astray on a share of the windows: the
    effect starts again beside those of that fit.
    """
    effects = base.effects | {name}
    stages = touched(investigation, vehicle, effects)
    found = fit_model(investigation, effects, vehicle, base, FIRST, stages=stages)
    if sum(part.sum() for part in found.cost.values()) <= sum(investigation.cost(base, each).sum() for each in stages):
        return found
    beside = joined(investigation, base.vehicle, name, vehicle.effects[name])
    return better(investigation, found, fit_model(investigation, effects, beside, base, FIRST, stages=stages))


def converged(data: FitData, found: FittedModel) -> FittedModel:
    """Return a fit carried on to its end."""
    if found.fit.converged:
        return found
    return settled_fit(data, found.effects, found.vehicle, found, stages=list(found.cost))


def again(data: FitData, found: FittedModel, changes: Mapping[str, float]) -> FittedModel:
    """Return a fit over the same stages that starts from a fitted vehicle with some values changed."""
    vehicle = replace_values(found.vehicle, changes)
    return fit_model(data, found.effects, vehicle, found, LONGEST, stages=list(found.cost))


def without(investigation: Investigation, found: FittedModel, name: str) -> FittedModel:
    """Fit a vehicle that lacks one effect of a fitted one, over the same stages; return the better one of two starts.

    Beside that effect the other parameters may have gone where no small step leads back from: they start as the nominal
    fit has them, too.
    """
    others = {key: effect for key, effect in found.vehicle.effects.items() if key != name}
    vehicle, effects, base = replace(found.vehicle, effects=others), found.effects - {name}, investigation.base
    nominal = {u.name: base.theta[u.name] for u in unknowns_with(investigation, effects, vehicle) if not u.effect}
    starts = (vehicle, found), (replace_values(vehicle, nominal), base)
    return better(
        investigation, *(settled_fit(investigation, effects, *start, stages=list(found.cost)) for start in starts)
    )


def everywhere(data: FitData, found: FittedModel) -> FittedModel:
    """Identify all parameters again, over all stages, with the effects of a fit."""
    return settled_fit(data, found.effects, found.vehicle, found, stages=list(data.evidence))


def unfitted(investigation: Investigation) -> FittedModel:
    """Return the vehicle as configured, with initial states fitted only."""
    return fit_model(investigation, frozenset(), investigation.vehicle, investigation.base, RESTING, free=())
