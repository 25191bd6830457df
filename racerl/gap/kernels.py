"""The compiled kernels of a stage, by the effects in them; compiled once, then found in the cache."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from threading import Lock
from typing import NamedTuple

from racerl.gap.evidence import Evidence
from racerl.gap.presence import only_shifts, with_all
from racerl.gap.stage import SHIFTS, StageEquations, StageRollout
from racerl.vehicle.effects import Effect
from racerl.vehicle.parameter import values
from racerl.vehicle.vehicle import STATE, Vehicle


class StageKernel:
    """One stage of a vehicle with the effects of a catalogue in it, each present or absent by a parameter."""

    def __init__(
        self, evidence: Evidence, vehicle: Vehicle, free: Sequence[str], catalogue: Mapping[str, Effect]
    ) -> None:
        everything = evidence.stage.vehicle(with_all(vehicle, catalogue))
        # a presence that may be 0 keeps what its effect replaces in the kernel: effects that are always there have none
        always = {f"effects.{name}.presence" for name in vehicle.effects.keys() - catalogue.keys()}
        table = {name: value for name, value in values(everything).items() if name not in always}
        inside = [name for name in table if name in free or ".effect." in name]
        presences = [name for name in table if name.endswith(".presence")]
        inside = StageEquations(everything, [*inside, *presences], evidence.observed).effective
        # what is zero is left out of the kernel, except in effects; anything else may differ from car to car
        given = [name for name, v in table.items() if name not in inside and (float(v) != 0.0 or "effects." in name)]
        self.rollout = StageRollout(everything, [*inside, *SHIFTS], evidence.observed, given=given)
        self.catalogue = catalogue


class Part(NamedTuple):
    """What an effect has to do with a stage: nothing, or with states of the car that are none of it, too."""

    idle: bool
    coupling: bool


class StageKernels:
    """The kernels of a stage, by the effects in them: none, one, all that leave it apart from other stages, or all.

    Few effects make fast kernels, many spare the compiler: sets of two and more share one, and effects that do not act
    in the stage are in none. Threads make different ones at once, and wait for one that another makes.
    """

    def __init__(
        self, evidence: Evidence, vehicle: Vehicle, free: Sequence[str], catalogue: Mapping[str, Effect]
    ) -> None:
        self._make = lambda effects: StageKernel(evidence, vehicle, free, effects)
        acting = partial(_acting, evidence, vehicle)
        alone = cache(lambda: acting({})[0])
        self._part = cache(lambda name: _part(*acting({name: catalogue[name]}), alone()))
        self._catalogue, self._always = catalogue, set(vehicle.effects)
        self._made: dict[frozenset[str], StageKernel] = {}
        self._locks: dict[frozenset[str], Lock] = {}

    def choose(self, vehicle: Vehicle, *, whole: bool = False) -> StageKernel:
        """Return the least kernel that has all the vehicle's effects in it; `whole`: the one that has all there are."""
        acting = (n for n, effect in vehicle.effects.items() if not only_shifts(effect))
        present = {name for name in acting if name not in self._always and not self._part(name).idle}
        names, everything = frozenset(present), frozenset(self._catalogue)
        if whole or (len(present) > 1 and any(self._part(name).coupling for name in present)):
            names = everything
        elif len(present) > 1:
            known = self._catalogue.items()
            names = everything - {n for n, effect in known if not only_shifts(effect) and self._part(n).coupling}
        with self._locks.setdefault(names, Lock()):
            if names not in self._made:
                chosen = {n: effect for n, effect in self._catalogue.items() if n in names or only_shifts(effect)}
                self._made[names] = self._make(chosen)
        return self._made[names]


def _part(states: set[str], parameters: set[str], alone: set[str]) -> Part:
    """Return what an effect has to do with a stage that, without it, depends on the states `alone`."""
    return Part(not parameters, bool((states - alone) & set(STATE)))


def _acting(evidence: Evidence, vehicle: Vehicle, effects: Mapping[str, Effect]) -> tuple[set[str], set[str]]:
    """Return the states that a stage of a vehicle with some effects depends on, and those of their parameters."""
    car = evidence.stage.vehicle(replace(vehicle, effects={**vehicle.effects, **effects}))
    own = [name for name in values(car) if name.startswith("effects.") and name.split(".")[1] in effects]
    equations = StageEquations(car, own, evidence.observed)
    return set(equations.active), set(equations.effective)
