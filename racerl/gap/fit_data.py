"""What all fits of a diagnosis share: the logs, cut for every stage, and what a fit to them may change."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from racerl.estimation.unknowns import Unknown
from racerl.gap.checkpoint import Checkpoint
from racerl.gap.configurable import NUMBERS
from racerl.gap.evidence import Evidence
from racerl.gap.kernels import StageKernels
from racerl.gap.stage_problem import matters
from racerl.gap.workers import Workers
from racerl.vehicle.effects import Effect
from racerl.vehicle.vehicle import Vehicle

Array = NDArray[np.float64]
SAMPLED = 3  # every which window trials, and the nominal fit to the shortest windows, look at
FEW = 60  # windows, or little more, that tell which of many trials are worth a fit


@dataclass(frozen=True, eq=False)
class FitData:
    """Logs, cut for every stage, the vehicle as configured, and the effects that it may lack, at usual sizes.

    `limits` replace bounds of some parameters. `noise` is that of every observed channel; `sigma` what weighs its
    errors: the noise, and a share of what the nominal fit leaves. `strength` is λ of the priors in every stage.
    """

    evidence: Mapping[str, Evidence]
    vehicle: Vehicle
    unknowns: Sequence[Unknown]
    catalogue: Mapping[str, Sequence[Effect]]
    limits: Mapping[str, tuple[float, float]]
    kernels: Mapping[str, StageKernels]
    noise: Mapping[str, Array]
    sigma: Mapping[str, Array]
    strength: Mapping[str, float]
    workers: Workers
    checkpoint: Checkpoint

    def determined(self, stages: Iterable[str]) -> set[str]:
        """Return the vehicle's parameters that the outcome of some stages depends on."""
        return {u.name for u in self.unknowns for name in stages if self._matters(name, u.name)}

    def known_elsewhere(self, stages: Sequence[str]) -> set[str]:
        """Return the vehicle's parameters that other stages than these determine: they stay as those found them."""
        others = [name for name in self.evidence if name not in stages]
        return self.determined(others) - self.determined(stages)

    def _matters(self, stage: str, unknown: str) -> bool:
        return matters(self.evidence[stage], self.kernels[stage].choose(self.vehicle), self.vehicle, unknown)


def kernels_of(
    evidence: Mapping[str, Evidence],
    vehicle: Vehicle,
    unknowns: Sequence[Unknown],
    catalogue: Mapping[str, Sequence[Effect]],
) -> dict[str, StageKernels]:
    """Return the kernels of every stage; an effect's size does not matter to them."""
    free = sorted({*NUMBERS, *(unknown.name for unknown in unknowns)})
    any_size = {name: sizes[0] for name, sizes in catalogue.items()}
    return {name: StageKernels(each, vehicle, free, any_size) for name, each in evidence.items()}


def sampled(evidence: Mapping[str, Evidence], *, most: int | None = None) -> dict[str, NDArray[np.int64]]:
    """Return a share of each stage's windows, `most` of them or little more."""
    every = {name: max(SAMPLED, len(each.start) // most if most else 0) for name, each in evidence.items()}
    return {name: np.arange(len(each.start))[:: every[name]] for name, each in evidence.items()}
