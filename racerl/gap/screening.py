"""Screening: which effects of the catalogue are worth a fit.

The score test ranks them by first-order theory; a few steps on a share of the windows, from several starts, rank those
that it puts first.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from racerl.estimation.pseudo_huber import pseudo_huber
from racerl.gap.candidates import joined
from racerl.gap.catalogue import placed
from racerl.gap.fit_data import FEW, sampled
from racerl.gap.fitted_model import COG, FittedModel, begun, fit_model, touched, unknowns_with
from racerl.gap.growth import places
from racerl.gap.investigation import Investigation
from racerl.gap.normal_equations import usual_cost
from racerl.gap.score import FELT, REMAINDER, SHOWS, Score, score
from racerl.gap.stage import TYRES
from racerl.gap.stage_problem import StageProblem
from racerl.vehicle.effects import Effect
from racerl.vehicle.parameter import replace_values, values
from racerl.vehicle.vehicle import Vehicle

Array = NDArray[np.float64]
STEPS = 5  # of a fit on a share of the windows: fewer may lead from a usual size to nothing better yet
ASTRAY = 1.3  # times the noise's cost, beyond which a fit says little of the parameters
LOST = 5.0  # times the noise's cost, beyond which a fit says nothing of what is missing
PLACES, REACH = 2, 1.5  # of an effect that lies somewhere: places that fits start from, and their size in m
SHORTLIST, CONTINUED = 12, 4  # of each stage: screened by first-order gain, and fitted to the end
FAINT = 0.15  # of the most gain in screening, below which a candidate is given up
BEHIND = 0.3  # of the most fall after a few steps, below which a candidate is not fitted to its end
FORETOLD, FIRST = 0.5, 2  # of the most first-order gain, above which so many are fitted whatever screening says


class Screened(NamedTuple):
    """A candidate after a few steps: the vehicle that it led to, its gain, and the stage that gains most."""

    name: str
    vehicle: Vehicle
    gain: float
    stage: str


def scores(investigation: Investigation, base: FittedModel) -> dict[str, Score]:
    """Return the score of every effect that a fitted vehicle lacks, per stage."""

    def scored(name: str) -> Score:
        known = investigation.known_elsewhere([name])
        unknowns = [u for u in unknowns_with(investigation, base.effects, base.vehicle) if u.name not in known]
        evidence, kernels = investigation.evidence[name], investigation.kernels[name]
        problem = StageProblem.of(evidence, kernels, base.vehicle, unknowns, investigation.sigma[name], whole=True)
        part = score(problem, unknowns, base.theta, begun(problem, base.initial, None), base.strength[name])
        share = REMAINDER if investigation.shaped and name == TYRES else FELT  # as a candidate is judged
        return replace(part, least=np.where(np.diag(part.H) > 0.0, share * investigation.floor[name], 0.0))

    names = list(investigation.evidence)  # side by side: their kernels are the largest, and take longest to compile
    return dict(zip(names, investigation.workers.each(scored, names), strict=True))


def lost(investigation: Investigation, base: FittedModel) -> set[str]:
    """Return the stages in which a fit is so far off that first-order theory says nothing."""
    return {stage for stage in investigation.evidence if beyond(investigation, base, [stage]) > LOST}


def shortlist(ahead: Mapping[str, Score], astray: Collection[str]) -> list[str]:
    """Return the effects with the largest first-order gains in each stage, since stages do not compete.

    In stages where a fit is astray, first-order theory says nothing, and all are looked at.
    """
    names: list[str] = []
    for stage, part in ahead.items():
        least = 0.0 if stage in astray else SHOWS
        gains = {name: gain for name, gain in part.gains().items() if gain > least}
        names += sorted(gains, key=lambda name: -gains[name])[: None if stage in astray else SHORTLIST]
        if stage == "chassis" and gains:  # the score knows one place only
            names += [name for name in part.names if placed(name)]
    return list(dict.fromkeys(names))


def hopeful(tried: Sequence[Screened], ahead: Score, stage: str) -> list[Screened]:
    """Return the candidates that screening found to help one stage most, and those that should by first-order theory.

    A few steps do not lead every effect to where it helps.
    """
    mine = [each for each in tried if each.stage == stage and each.gain > 0.0]
    mine.sort(key=lambda each: -each.gain)
    found = [each for each in mine[:CONTINUED] if each.gain > FAINT * mine[0].gain]
    gains = ahead.gains()
    most = max([SHOWS, *gains.values()])
    foretold = [each for each in tried if gains.get(each.name, 0.0) > FORETOLD * most]
    foretold.sort(key=lambda each: -gains[each.name])
    return [*found, *foretold[:FIRST]]


def screen(
    investigation: Investigation, base: FittedModel, name: str, fitted: Sequence[Effect] = ()
) -> Screened | None:
    """Add an effect to a fitted vehicle: a few steps from each of its usual sizes, on a share of the windows.

    It starts as it was `fitted` beside fewer effects, too. Where the fit is astray, the best of these ends starts again
    with all parameters but the effects' as configured. Return the best; None where no stage shows the effect.
    """
    likely = [
        joined(investigation, base.vehicle, name, each) for each in (*_likely(investigation, base, name), *fitted)
    ]
    stages = touched(investigation, likely[0], [name]) if likely else []
    if not stages:
        return None
    best = max((_try(investigation, base, name, vehicle, stages) for vehicle in likely), key=lambda each: each.gain)
    if beyond(investigation, base, stages) < ASTRAY:
        return best
    configured = values(investigation.vehicle)
    own = {parameter: float(configured[parameter]) for parameter in investigation.determined(stages)}
    again = _try(investigation, base, name, replace_values(best.vehicle, own), stages)
    return max(best, again, key=lambda each: each.gain)


def beyond(investigation: Investigation, base: FittedModel, stages: Iterable[str]) -> float:
    """Return a fit's cost in some stages, in that of the noise: far above 1 the parameters may be astray."""
    names = list(stages)
    cost = sum(investigation.cost(base, name).sum() for name in names)
    return float(cost / sum(investigation.floor[name] for name in names))


def _try(
    investigation: Investigation, base: FittedModel, name: str, vehicle: Vehicle, stages: Sequence[str]
) -> Screened:
    """Return where a few iterations on a share of the windows lead a vehicle with an effect more."""
    some = sampled({name: investigation.evidence[name] for name in stages}, most=FEW)
    found = fit_model(investigation, base.effects | {name}, vehicle, base, STEPS, stages=stages, index=some)
    gains = {
        stage: _fall(investigation, stage, investigation.cost(base, stage)[some[stage]], found.cost[stage])
        for stage in stages
    }
    return Screened(name, found.vehicle, sum(gains.values()), max(gains, key=lambda stage: gains[stage]))


def gainful(investigation: Investigation, base: FittedModel, fits: Sequence[FittedModel]) -> list[FittedModel]:
    """Return the fits by which the loss of all windows falls, and not by little beside the best: a few steps tell."""
    falls = [
        sum(_fall(investigation, stage, investigation.cost(base, stage), cost) for stage, cost in each.cost.items())
        for each in fits
    ]
    least = BEHIND * max([0.0, *falls])
    return [each for each, fall in zip(fits, falls, strict=True) if fall > least]


def _fall(investigation: Investigation, stage: str, before: Array, after: Array) -> float:
    """Return the fall of the loss of a stage's windows."""
    usual = usual_cost(investigation.evidence[stage], before)
    return float((pseudo_huber(before, usual) - pseudo_huber(after, usual)).sum())


def _likely(investigation: Investigation, base: FittedModel, name: str) -> list[Effect]:
    """Return the starts of an effect; one that lies somewhere starts where errors grow most.

    A centre of gravity that is elsewhere starts where the refit put it.
    """
    starts, evidence = list(investigation.catalogue[name]), investigation.evidence.get("chassis")
    if name == COG and base.vehicle.l_f != investigation.vehicle.l_f:
        return [replace(starts[0], **{"offset": investigation.vehicle.l_f - base.vehicle.l_f})]
    if not placed(name) or evidence is None or not {"x", "y"} <= set(evidence.columns):
        return starts
    found = base if "chassis" in base.cost else investigation.base
    errors, noise = found.errors()["chassis"], investigation.noise["chassis"]
    return [replace(starts[0], **{"x": x, "y": y}) for x, y in places(evidence, errors, noise, REACH, PLACES)]
