"""One stage's share of a fit: what of θ it depends on, its kernel, and its windows with their noise."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from racerl.estimation.unknowns import Unknown
from racerl.gap.evidence import Evidence
from racerl.gap.follow import follow
from racerl.gap.kernels import StageKernel, StageKernels
from racerl.gap.presence import inner, only_shifts, with_all
from racerl.gap.stage import SHIFTS, StageRollout
from racerl.vehicle.parameter import replace_values, values
from racerl.vehicle.rollout import Windows
from racerl.vehicle.vehicle import STATE, Vehicle

Array = NDArray[np.float64]


@dataclass(frozen=True)
class StageProblem:
    """One stage's share of a fit: θ's names that it depends on, its kernel and its windows' noise."""

    evidence: Evidence
    kernel: StageKernel
    vehicle: Vehicle
    names: tuple[str, ...]  # of θ, in this stage
    sigma: Array  # (C,)

    @classmethod
    def of(
        cls,
        evidence: Evidence,
        kernels: StageKernels,
        vehicle: Vehicle,
        unknowns: Sequence[Unknown],
        sigma: Array,
        *,
        whole: bool = False,
    ) -> "StageProblem":
        """Choose the unknowns that matter to the stage, and its kernel; `whole`: one with the whole catalogue."""
        kernel = kernels.choose(vehicle, whole=whole)
        matter = [u.name for u in unknowns if matters(evidence, kernel, vehicle, u.name)]
        return cls(evidence, kernel, vehicle, tuple(matter), sigma)

    @staticmethod
    def touched(evidence: Evidence, kernels: StageKernels, vehicle: Vehicle, unknowns: Sequence[Unknown]) -> bool:
        """Return whether the stage's outcome depends on any of the unknowns."""
        kernel = kernels.choose(vehicle)
        return any(matters(evidence, kernel, vehicle, unknown.name) for unknown in unknowns)

    @property
    def rollout(self) -> StageRollout:
        """Return the kernel's rollout."""
        return self.kernel.rollout

    def told(self) -> list[Any]:
        """Return all that a fit of these windows comes from, but for where it starts."""
        table = {name: float(value) for name, value in values(self.vehicle).items()}
        of_effects = [list(self.vehicle.effects), list(self.kernel.catalogue), self.rollout.names]
        windows = [self.evidence.stage.name, self.evidence.early, self.evidence.length, self.evidence.start]
        return [*windows, self.names, self.sigma, table, of_effects]

    def columns(self) -> list[int]:
        """Return the kernel's unknowns that are needed: parameters, shifts, and initial states that act."""
        names = self.rollout.names
        asked = [i for i, share in enumerate(np.abs(self.mixing).sum(axis=1)) if share > 0.0]
        return asked + [len(names) + i for i, state in enumerate(self.rollout.active) if self.has(state)]

    def has(self, state: str) -> bool:
        """Return whether a state is the car's own, or one of an effect that is present."""
        return state in STATE or state.split(".")[0] in self.vehicle.effects

    def silent(self) -> set[str]:
        """Return the states of effects that are absent."""
        return {state for state in self.rollout.active if not self.has(state)}

    @cached_property
    def memory(self) -> dict[int, str]:
        """Return the time constants, among the unknowns, of own states that remember more than a window, by row."""
        return {
            row: name
            for row, state in enumerate(self.rollout.vehicle.states)
            for name in self.names
            if row >= len(STATE) and self.has(state) and _remembered(self.vehicle, state, name)
        }

    def shifts(self, theta: Mapping[str, float]) -> tuple[float, float]:
        """Return the shifts of both inputs, in s."""
        late = any(only_shifts(effect) for effect in self.vehicle.effects.values())
        first, second = self.evidence.stage.shifts(_with(self.vehicle, theta) if late else self.vehicle)
        return float(first), float(second)

    @cached_property
    def mixing(self) -> Array:
        """∂(kernel parameters)/∂(names), (P, N)."""
        kernel = self.rollout.names
        matrix = np.zeros((len(kernel), len(self.names)))
        for column, name in enumerate(self.names):
            if inner(name) in kernel:
                matrix[kernel.index(inner(name)), column] = 1.0
            else:
                for shift, share in zip(SHIFTS, _shift_of(self.evidence, self.vehicle, name), strict=True):
                    matrix[kernel.index(shift), column] = share
        return matrix

    def parameters(self, theta: Mapping[str, float]) -> Array:
        """Return the kernel's parameters; its shifts are zero, since the inputs are shifted already."""
        place, found = self._parameters
        found = found.copy()
        for name, value in theta.items():
            if inner(name) in place:
                found[place[inner(name)]] = value
        return found

    @cached_property
    def _parameters(self) -> tuple[dict[str, int], Array]:
        """The places of the kernel's parameters, and what they are in the vehicle as it is."""
        names, table = [*self.rollout.names, *self.rollout.given], values(self.everything({}))
        return {name: i for i, name in enumerate(names)}, np.array([float(table.get(name, 0.0)) for name in names])

    def everything(self, theta: Mapping[str, float]) -> Vehicle:
        """Return the kernel's vehicle with θ's values."""
        return self.evidence.stage.vehicle(with_all(_with(self.vehicle, theta), self.kernel.catalogue))

    def windows(self, theta: Mapping[str, float]) -> Windows:
        """Return the windows with inputs at θ's shifts, weighted by the noise."""
        windows = self.evidence.windows(self.rollout.vehicle.states, self.shifts(theta))
        return replace(windows, weight=np.repeat(1.0 / self.sigma[:, None], windows.initial.shape[1], axis=1))

    def errors(self, theta: Mapping[str, float], initial: Array) -> Array:
        """Return simulated − measured (T + 1, C, W)."""
        windows = replace(self.windows(theta), initial=initial)
        return self.rollout.predict(self.parameters(theta), windows) - windows.measured

    def at(self, theta: Mapping[str, float]) -> "StageProblem":
        """Return the stage's share at θ, of which nothing varies."""
        return replace(self, names=(), vehicle=_with(self.vehicle, theta))

    @cached_property
    def own_states(self) -> Array:
        """The effects' own states along the log (S − 8, R), led by the measured motion."""
        car = self.evidence.stage.vehicle(self.vehicle)
        followed = dict(zip(car.states[len(STATE) :], follow(car, self.evidence, self.shifts({})), strict=True))
        silent = np.zeros(len(self.evidence.first))
        return np.array([followed.get(name, silent) for name in self.rollout.vehicle.states[len(STATE) :]])


def _with(vehicle: Vehicle, theta: Mapping[str, float]) -> Vehicle:
    known = values(vehicle)
    return replace_values(vehicle, {name: value for name, value in theta.items() if name in known})


def _remembered(vehicle: Vehicle, state: str, name: str) -> bool:
    effect = state.split(".")[0]
    return name.startswith(f"effects.{effect}.") and name.rpartition(".")[2] in vehicle.effects[effect].memory


def matters(evidence: Evidence, kernel: StageKernel, vehicle: Vehicle, name: str) -> bool:
    """Return whether a stage's outcome depends on a parameter."""
    return inner(name) in kernel.rollout.names or _shift_of(evidence, vehicle, name) != (0.0, 0.0)


def _shift_of(evidence: Evidence, vehicle: Vehicle, name: str) -> tuple[float, float]:
    """Return by how much one second of a parameter shifts the stage's inputs."""
    if not name.startswith("effects."):
        return 0.0, 0.0
    if not only_shifts(vehicle.effects[name.split(".")[1]]):
        return 0.0, 0.0
    up, none = (_with(vehicle, {name: size}) for size in (1.0, 0.0))
    at_one, at_none = evidence.stage.shifts(up), evidence.stage.shifts(none)
    return at_one[0] - at_none[0], at_one[1] - at_none[1]
