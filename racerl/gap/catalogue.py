"""Where a fit of each effect starts: usual sizes, from `conf/vehicle/effect`, of both signs where both are physical."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from racerl.documents import read_yaml
from racerl.vehicle import catalogue
from racerl.vehicle.effects import Effect

SIZES = (1.0, 0.25)  # of the usual values, where only one sign is physical
PLACES = 3  # along each axis, from which the place of an effect is looked for


def starts(name: str, folder: Path, extent: NDArray[np.float64]) -> list[Effect]:
    """Return an effect in several sizes; `extent` (2, 2) is the least and greatest x and y that the log visits."""
    entry = catalogue.entry(name)
    usual = {key: float(value) for key, value in read_yaml(folder / f"{name}.yaml").items()}
    first = next(iter(entry.parameters))
    bounds = entry.parameters[first]
    neutral = 1.0 if bounds.low > 0.0 and bounds.low < 1.0 < bounds.high and bounds.unit == "" else 0.0
    if {"x", "y"} <= set(usual) and entry.parameters["x"].unit == "m":
        return [entry.cls(**{**usual, "x": x, "y": y}) for x, y in _places(extent)]
    effect = entry.cls(**usual)
    away = usual[first] - neutral
    if bounds.low <= neutral - away <= bounds.high and (bounds.low < 0.0 or neutral == 1.0):
        return [effect, replace(effect, **{first: neutral - away})]
    return [replace(effect, **{first: neutral + size * away}) for size in SIZES]


def _places(extent: NDArray[np.float64]) -> Sequence[tuple[float, float]]:
    """Return the middles of a grid over what the log visits."""
    shares = (np.arange(PLACES) + 0.5) / PLACES
    x, y = (low + shares * (high - low) for low, high in extent)
    return [(float(a), float(b)) for a in x for b in y]
