"""Where a fit of each effect starts: usual sizes, from `conf/vehicle/effect`, of both signs where both are physical."""

from dataclasses import replace
from pathlib import Path

from racerl.documents import read_yaml
from racerl.vehicle import catalogue
from racerl.vehicle.effects import Effect

SIZES = (1.0, 0.25)  # of the usual values, where only one sign is physical


def starts(name: str, folder: Path) -> list[Effect]:
    """Return an effect in several sizes."""
    entry = catalogue.entry(name)
    usual = {key: float(value) for key, value in read_yaml(folder / f"{name}.yaml").items()}
    first = next(iter(entry.parameters))
    bounds = entry.parameters[first]
    neutral = 1.0 if bounds.low > 0.0 and bounds.low < 1.0 < bounds.high and bounds.unit == "" else 0.0
    effect = entry.cls(**usual)
    away = usual[first] - neutral
    if bounds.low <= neutral - away <= bounds.high and (bounds.low < 0.0 or neutral == 1.0):
        return [effect, replace(effect, **{first: neutral - away})]
    return [replace(effect, **{first: neutral + size * away}) for size in SIZES]


def placed(name: str) -> bool:
    """Return whether an effect lies at some place (x, y) of the world."""
    parameters = catalogue.entry(name).parameters
    return {"x", "y"} <= set(parameters) and parameters["x"].unit == "m"
