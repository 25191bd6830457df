"""The nominal fit: the vehicle without further effects, fitted to its minimum from wherever it starts.

It looks at windows of 10 samples, then of 30, then at all of every window, for errors over short windows lead straight
there. It starts from the configured vehicle and from some drawn within the priors, until the best end is met twice.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from racerl.estimation.unknowns import Unknowns
from racerl.gap.evidence import Evidence
from racerl.gap.fit_data import FitData, sampled
from racerl.gap.fitted_model import LONGEST, FittedModel, begun, fit_model, loss, settled_fit
from racerl.gap.stage_fit import StageFit
from racerl.vehicle.parameter import replace_values
from racerl.vehicle.vehicle import Vehicle

Array = NDArray[np.float64]
NOTHING: frozenset[str] = frozenset()
SHARE = 0.1  # of a channel's misfit that counts as noise in its weight
GROWTH = (10, 30)  # samples of the windows that are looked at first: errors grow less crooked in them
STARTS, TWICE = 6, 0.01  # most starts; share by which two that end at the best differ
CARRIED = 3  # times that a fit which still falls is carried on
CROSSED, GAINED = 10, 0.001  # times that windows begin anew; share by which the fit must get better by it
EVEN = 0.05  # excess over the noise's cost at which an actuator's command counts as rightly timed
PROBE, MENDED = 0.1, 0.15  # of a sample earlier must take so much of an excess away for a command's timing to matter


@dataclass(frozen=True, eq=False)
class Nominal:
    """The vehicle without further effects, fitted, and whether two starts ended there."""

    model: FittedModel
    met_twice: bool

    def doubts(self) -> list[str]:
        """Return what speaks against this being the best fit there is, a line each."""
        lines = []
        if not self.met_twice:
            lines.append("the starts of the refit did not agree on one fit; a better one may exist")
        if not self.model.fit.converged:
            lines.append(f"the refit did not reach a minimum: {self.model.fit.why}; a better fit may exist")
        return lines


def timed(data: FitData) -> FitData:
    """Return the data with each actuator's command as early as lets the vehicle reach the noise, where one does.

    What is sent between two samples is logged with the later one.
    """
    for stage in {"steering", "drive"} & set(data.evidence):
        data = _at(data, stage, _early(data, stage))
    return data


def _early(data: FitData, stage: str) -> float:
    """Return by how many seconds a stage's command was sent before the sample that first shows it."""
    given = data.evidence[stage]
    enough = (1.0 + EVEN) * given.numbers * len(given.start)

    def cost(early: float) -> float:
        found = fit_model(_at(data, stage, early), NOTHING, data.vehicle, None, LONGEST, stages=[stage])
        return float(found.cost[stage].sum())

    late = cost(0.0)
    if late <= enough or late - cost(PROBE * given.dt) < MENDED * (late - enough):
        return given.early
    best = minimize_scalar(cost, bounds=(0.0, given.dt), method="bounded", options={"xatol": 0.02 * given.dt})
    return float(best.x) if best.fun <= enough else given.early


def _at(data: FitData, stage: str, early: float) -> FitData:
    return replace(data, evidence={**data.evidence, stage: replace(data.evidence[stage], early=float(early))})


def drawn(vehicle: Vehicle, unknowns: Unknowns) -> list[Vehicle]:
    """Return the configured vehicle and others within one prior deviation of it; always the same ones."""
    generator = np.random.default_rng(0)
    starts = [unknowns.draw_within(generator).tolist() for _ in range(STARTS - 1)]
    return [vehicle, *(replace_values(vehicle, dict(zip(unknowns.names, start, strict=True))) for start in starts)]


def fit_nominal(data: FitData, starts: Sequence[Vehicle]) -> tuple[FitData, Nominal]:
    """Fit the vehicle; return the data with channels weighed by their noise and a share of what is left over, too."""
    found: list[FittedModel] = []
    while len(found) < len(starts) and not _met_twice(data, found):
        found += data.workers.each(lambda start: grown(data, start), starts[len(found) : len(found) + 2])
    best = min(found, key=lambda each: loss(data, each))
    for _ in range(CROSSED):
        other = _crossed(data, best, found)
        if loss(data, other) > (1.0 - GAINED) * loss(data, best):
            break
        best = other
    data = _weighed(data, best)
    model = settled_fit(data, NOTHING, best.vehicle, best)
    return replace(data, strength=model.strength), Nominal(model, _met_twice(data, found))


def _met_twice(data: FitData, found: Sequence[FittedModel]) -> bool:
    """Return whether the two best fits ended at the same cost; one that still falls has not ended."""
    best = sorted((loss(data, each), each.fit.converged) for each in found)[:2]
    ended = len(best) > 1 and all(converged for _, converged in best)
    return ended and best[1][0] <= (1.0 + TWICE) * best[0][0]


def _crossed(data: FitData, best: FittedModel, found: Sequence[FittedModel]) -> FittedModel:
    """Return the best fit carried on with every window begun where any of the fits begins it, whichever fits it best.

    At the limit of grip a window has several initial states that no small step betters: fits differ by which they met.
    """
    initial = {}
    for stage in best.problem.stages:
        name = stage.evidence.stage.name
        work = StageFit(stage.at(best.theta), {}, None, best.strength[name])
        others = [each for each in found if each is not best]
        ways = [settled_from(work, begun(stage, each.initial, None)) for each in (best, *others)]
        cost = np.nan_to_num([way[0] for way in ways], nan=np.inf)
        rows = np.choose(np.argmin(cost, axis=0), [way[1] for way in ways])
        initial[name] = dict(zip(stage.rollout.vehicle.states, rows, strict=True))
    return settled_fit(data, NOTHING, best.vehicle, replace(best, initial=initial))


def settled_from(work: StageFit, initial: Array) -> tuple[Array, Array]:
    """Return the cost of every window (W,) from there, and where it begins once its state has settled, (S, W)."""
    work.initial = initial.copy()
    return work.settled(), work.initial


def _weighed(data: FitData, best: FittedModel) -> FitData:
    """Return the data with noise and weights by what a fit leaves."""
    noise, sigma = dict(data.noise), dict(data.sigma)
    for name, errors in best.errors().items():
        left = (errors**2).mean(axis=(0, 2))
        noise[name] = np.minimum(noise[name], np.sqrt(left))  # local polynomials miss fast motion
        sigma[name] = np.sqrt(noise[name] ** 2 + SHARE**2 * left)
    return replace(data, noise=noise, sigma=sigma)


def grown(data: FitData, vehicle: Vehicle) -> FittedModel:
    """Fit the vehicle to windows that grow."""
    strength: Mapping[str, float] = data.strength
    for length in GROWTH:
        shorter = _parted(data, length)
        if set(shorter) == set(data.evidence):
            index = sampled(shorter) if length == GROWTH[0] else None
            part = replace(data, evidence=shorter)
            found = settled_fit(part, NOTHING, vehicle, None, index=index, strength=strength)
            vehicle, strength = found.vehicle, found.strength
    found = settled_fit(data, NOTHING, vehicle, None, strength=strength)
    for _ in range(CARRIED):
        if found.fit.converged:
            break
        found = settled_fit(data, NOTHING, found.vehicle, found)
    return found


def _parted(data: FitData, length: int) -> dict[str, Evidence]:
    return {name: each.parted(length) for name, each in data.evidence.items() if each.length > length}
