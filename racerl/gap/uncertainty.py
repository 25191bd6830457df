"""How sure a fitted model's parameters are: deviations robust against errors that hang together, and intervals."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from racerl.gap.catalogue import PLACE, neutral, placed
from racerl.gap.checkpoint import Parts
from racerl.gap.fitted_model import COG, FittedModel
from racerl.gap.folds import blocks
from racerl.gap.investigation import Investigation
from racerl.identify.uncertainty import normal
from racerl.vehicle.parameter import specifications
from racerl.vehicle.vehicle import Vehicle

Array = NDArray[np.float64]
FAR = 2.0  # prior deviations, beyond which a refitted parameter is a clue in itself
FORM = 0.05  # deviation, as a share, between the parameters of an effect's forms where it has many (development logs)
EXACT = 0.01  # the same, where it has one; and of the vehicle's numbers (0.2 ms between samples are 1 % of a stiffness)
TIMING = 0.1  # the same of a dead time, in samples: when within one a command acts is every logger's own affair


def deviations(investigation: Investigation, found: FittedModel) -> dict[str, float]:
    """Return the standard deviation of every parameter of a fit.

    How far the centre of gravity is from where it was weighed is known no better than it was weighed.
    """

    def variances() -> Parts:
        return {"variances": np.diag(_covariance(investigation, found))}

    checkpoint = investigation.checkpoint
    parts = checkpoint.recall(checkpoint.key("variances", found.key), variances)
    found_deviations = np.sqrt(np.maximum(parts["variances"], 0.0)).tolist()
    known = dict(zip(found.problem.names, found_deviations, strict=True))
    offset, weighed = f"effects.{COG}.offset", {u.name: u.sigma for u in investigation.unknowns}.get("l_f", 0.0)
    return {**known, offset: float(np.hypot(known[offset], weighed))} if offset in known else known


def _covariance(investigation: Investigation, found: FittedModel) -> Array:
    number = blocks({name: investigation.evidence[name] for name in found.cost})
    return found.problem.covariance(found.fit, list(number.values()))


def possible_cars(investigation: Investigation, found: FittedModel, seed: int) -> Array:
    """Return cars (K, P) that the logs leave possible, in the order of the fit's parameters."""
    names, covariance = found.problem.names, _covariance(investigation, found)
    mean = np.array([found.theta[name] for name in names])
    sure = deviations(investigation, found)
    dt = _sample(investigation)
    variance = [sure[name] ** 2 + _form(found.vehicle, name, found.theta[name], dt) ** 2 for name in names]
    wider = np.maximum(variance - np.diag(covariance), 0.0)  # by the form of an effect, and where the car was weighed
    return mean + normal(covariance + np.diag(wider), np.random.default_rng(seed))


def intervals(investigation: Investigation, found: FittedModel) -> dict[str, tuple[float, float, float]]:
    """Return each fitted parameter's value and 95 % interval, inside the physical bounds.

    An effect's parameters are known no better than its form is: the car's effect may have another. Nor are the
    vehicle's numbers: between samples inputs are taken as straight, where an actuator that follows a command bends.
    """
    bounds = {unknown.name: (unknown.low, unknown.high) for unknown in found.problem.unknowns}
    ranges, dt = {}, _sample(investigation)
    for name, deviation in deviations(investigation, found).items():
        value, (low, high) = found.theta[name], bounds[name]
        half = 1.96 * math.hypot(deviation, _form(found.vehicle, name, value, dt))
        ranges[name] = value, max(value - half, low), min(value + half, high)
    return ranges


def _sample(investigation: Investigation) -> float:
    return max(evidence.dt for evidence in investigation.evidence.values())


def _form(vehicle: Vehicle, parameter: str, value: float, dt: float) -> float:
    """Return the deviation between a parameter of an effect's likely forms, by its distance from no effect.

    That of a place is in the effect's own length, that of a dead time in samples of `dt` seconds, that of a number of
    the vehicle a share of it.
    """
    if not parameter.startswith("effects."):
        return EXACT * abs(value)
    name, _, key = parameter.removeprefix("effects.").rpartition(".")
    effect = vehicle.effects[name]
    if not effect.physical:
        return 0.0
    first, zero = neutral(name)
    size = value - zero if key == first else value
    if placed(name) and key in PLACE:
        size = float(getattr(effect, "radius", 0.0))
    if not effect.exact:
        return FORM * abs(size)
    delayed = specifications(effect)[key].unit == "s"
    return math.hypot(EXACT * size, TIMING * dt if delayed else 0.0)


def moved(investigation: Investigation) -> list[dict[str, Any]]:
    """Return the vehicle's parameters that the nominal fit took far from where they were configured, or to a bound."""
    rows = []
    for unknown in investigation.base.problem.unknowns:
        value = investigation.base.theta[unknown.name]
        bound = value in (unknown.low, unknown.high)
        if bound or abs(value - unknown.start) > FAR * unknown.sigma:
            rows.append({"name": unknown.name, "configured": unknown.start, "refitted": value, "at_bound": bound})
    return rows
