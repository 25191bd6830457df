"""An investigation: logs, cut for every stage, the nominal fit to them, and what noise alone would leave."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from racerl.estimation.unknowns import Unknowns
from racerl.gap.checkpoint import Checkpoint
from racerl.gap.evidence import Evidence
from racerl.gap.fit_data import FitData, kernels_of
from racerl.gap.fitted_model import FittedModel
from racerl.gap.folds import deal
from racerl.gap.noise import expected, noise_draws
from racerl.gap.nominal import Nominal, drawn, fit_nominal, timed
from racerl.gap.workers import Workers
from racerl.vehicle.effects import Effect
from racerl.vehicle.vehicle import Vehicle

Array = NDArray[np.float64]
TYRE_SHAPE, DOUBLE_TRACK = "tyre_shape", "double_track"
Folds = Mapping[str, NDArray[np.bool_]]  # the windows of every stage that a fold holds out


@dataclass(frozen=True, eq=False)
class Investigation(FitData):
    """What a diagnosis goes by.

    `noise_errors` (T + 1, C, W) and their cost, `floor`, per stage, are what noise alone would leave of the nominal
    fit, `chance` the share by which that differs from one drive to another; `folds` the windows that each fold holds
    out; `seed` that of noise and resamples, on which no fit depends.
    """

    nominal: Nominal
    noise_errors: Mapping[str, Array]
    floor: Mapping[str, float]
    chance: Mapping[str, float]
    folds: Sequence[Folds]
    seed: int

    @property
    def base(self) -> FittedModel:
        """The vehicle without further effects, fitted."""
        return self.nominal.model

    @property
    def shapes(self) -> list[str]:
        """The names of what the vehicle is that is no effect: a double track, tyres of another formula."""
        return [name for name in (DOUBLE_TRACK, TYRE_SHAPE) if name in self.vehicle.effects]

    @property
    def shaped(self) -> bool:
        """Whether the vehicle's tyre is of another shape than its formula's."""
        return TYRE_SHAPE in self.shapes

    def cost(self, found: FittedModel, stage: str) -> Array:
        """Return a fit's cost per window of a stage; the nominal one where its effects do not touch it."""
        return found.cost.get(stage, self.base.cost[stage])

    def knowing(self, catalogue: Mapping[str, Sequence[Effect]]) -> "Investigation":
        """Return the same logs and nominal fit with another catalogue of effects."""
        kernels = kernels_of(self.evidence, self.vehicle, self.unknowns, catalogue)
        return replace(self, catalogue=catalogue, kernels=kernels)

    def limited(self, limits: Mapping[str, tuple[float, float]]) -> "Investigation":
        """Return the same logs and nominal fit with other limits of some effects' parameters."""
        return replace(self, limits={**self.limits, **limits})


def investigate(
    evidence: Mapping[str, Evidence],
    vehicle: Vehicle,
    unknowns: Unknowns,
    catalogue: Mapping[str, Sequence[Effect]],
    *,
    limits: Mapping[str, tuple[float, float]] | None = None,
    folds: int = 8,
    threads: int = 1,
    seed: int = 0,
    checkpoint: Checkpoint | None = None,
) -> Investigation:
    """Fit the vehicle to the logs, from starts that do not depend on the seed: one log, one fit."""
    limits = dict(limits or {})
    bounds = {u.name: limits.get(u.name, (u.low, u.high)) for u in unknowns.each()}
    each = [replace(u, low=bounds[u.name][0], high=bounds[u.name][1]) for u in unknowns.each()]
    noise = {name: part.noise() for name, part in evidence.items()}
    data = FitData(
        dict(evidence),
        vehicle,
        each,
        catalogue,
        limits,
        kernels_of(evidence, vehicle, each, catalogue),
        noise,
        noise,
        dict.fromkeys(evidence, 1.0),
        Workers(threads),
        checkpoint or Checkpoint(),
    )
    data, nominal = fit_nominal(timed(data), drawn(vehicle, unknowns))
    return investigation_of(data, nominal, deal(data.evidence, folds), seed)


def investigation_of(data: FitData, nominal: Nominal, folds: Sequence[Folds], seed: int) -> Investigation:
    """Return an investigation by a nominal fit, with what noise alone would leave of it."""
    draws = noise_draws(data, nominal.model, seed)
    given = {field.name: getattr(data, field.name) for field in fields(FitData)}
    return Investigation(
        **given,
        nominal=nominal,
        noise_errors=expected(data, nominal.model, seed),
        floor={name: float(part.mean()) for name, part in draws.items()},
        chance={name: float(part.std() / part.mean()) for name, part in draws.items()},
        folds=folds,
        seed=seed,
    )
