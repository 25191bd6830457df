"""Where a fit of each effect starts: usual sizes, from `conf/vehicle/effect`, of both signs where both are physical."""

from dataclasses import replace
from pathlib import Path

from racerl.documents import read_yaml
from racerl.vehicle import catalogue
from racerl.vehicle.effects import Effect

PLACE = ("x", "y")
SIZES = (1.0, 0.25, 4.0)  # of the usual values, where only one sign is physical


def starts(name: str, folder: Path) -> list[Effect]:
    """Return an effect in several sizes."""
    entry = catalogue.entry(name)
    usual = {key: float(value) for key, value in read_yaml(folder / f"{name}.yaml").items()}
    first, zero = neutral(name)
    bounds, effect = entry.parameters[first], entry.cls(**usual)
    away = usual[first] - zero
    if bounds.low <= zero - away <= bounds.high and (bounds.low < 0.0 or zero == 1.0):
        return [effect, replace(effect, **{first: zero - away})]
    sizes = [zero + size * away for size in SIZES]
    return [replace(effect, **{first: size}) for size in sizes if bounds.low <= size <= bounds.high]


def neutral(name: str) -> tuple[str, float]:
    """Return an effect's first parameter, and the value at which the effect vanishes: 1 for factors, else 0."""
    first, bounds = next(iter(catalogue.entry(name).parameters.items()))
    return first, 1.0 if 0.0 < bounds.low < 1.0 < bounds.high and bounds.unit == "" else 0.0


def of_the_world(name: str) -> bool:
    """Return whether an effect has a place or a direction in the world, so that only a pose can show it."""
    return set(PLACE) <= set(catalogue.entry(name).parameters)


def placed(name: str) -> bool:
    """Return whether an effect lies at some place (x, y) of the world."""
    return of_the_world(name) and catalogue.entry(name).parameters["x"].unit == "m"
