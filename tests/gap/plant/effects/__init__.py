"""Every effect the plant can hide: those of the contract's catalogue, and some that no catalogue lists."""

from collections.abc import Mapping, Sequence

import numpy as np

from tests.gap.plant.effects import drive, place, resistance, sensing, steering, tyre, unlisted
from tests.gap.plant.effects.base import SIZES, Effect

CATALOGUE: dict[str, type[Effect]] = {
    effect.name: effect for module in (steering, drive, resistance, tyre, place, sensing) for effect in module.EFFECTS
}
# of racerl's catalogue, too, but asked for by name only: drawn sets are those of the seeds from before
LATER: dict[str, type[Effect]] = {effect.name: effect for effect in drive.LATER}
UNLISTED: dict[str, type[Effect]] = {effect.name: effect for effect in unlisted.EFFECTS}
ALL: dict[str, type[Effect]] = CATALOGUE | LATER | UNLISTED

Values = Mapping[str, float]


def build(cars: Sequence[Mapping[str, Values]]) -> list[Effect]:
    """The effects of a batch, from each car's {effect: {parameter: value}}; those that no car has are left out."""
    hidden = {name for car in cars for name in car}
    unknown = hidden - set(ALL)
    if unknown:
        raise KeyError(f"no effect {sorted(unknown)}; known: {' '.join(ALL)}")
    return [_over_batch(kind, cars) for name, kind in ALL.items() if name in hidden]


def draw(name: str, size: str, rng: np.random.Generator, place: tuple[float, float]) -> dict[str, float]:
    """One hidden effect's values: those of its size ±10 %, signs drawn, and a patch put where the programme drives."""
    kind = ALL[name]
    values = dict(kind.sizes[size])
    for parameter in kind.units:
        if parameter not in kind.fixed:
            values[parameter] *= rng.uniform(0.9, 1.1)
        if parameter in kind.signed:
            values[parameter] *= rng.choice([-1.0, 1.0])
    if "x" in values:
        values |= {"x": place[0], "y": place[1]}
    return values


def _over_batch(kind: type[Effect], cars: Sequence[Mapping[str, Values]]) -> Effect:
    """One effect over all cars; cars without it carry the medium values, unused."""
    values = [car.get(kind.name, kind.sizes["medium"]) for car in cars]
    stacked = {parameter: np.array([value[parameter] for value in values]) for parameter in kind.units}
    return kind(np.array([kind.name in car for car in cars]), stacked)


__all__ = ["ALL", "CATALOGUE", "SIZES", "UNLISTED", "Effect", "build", "draw"]
