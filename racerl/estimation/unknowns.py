"""What a fit may change: the free parameters with their priors and physical bounds."""

import fnmatch
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from racerl import bounds
from racerl.errors import ConfigError, suggest
from racerl.vehicle.parameter import Parameter, specifications, values
from racerl.vehicle.vehicle import Vehicle

Array = NDArray[np.float64]


EFFECTS = "effects.*"  # a pattern that may find none
HELD = "a list of parameters or patterns is expected, for instance hold=[l_f]"
FORMS = "allowed is a share ≥ 0, {absolute: …} or {share: …}, with within: [low, high] beside it if need be, or null"


@dataclass(frozen=True)
class Unknown:
    """One parameter of a fit, with its prior and bounds."""

    name: str
    start: float
    sigma: float
    low: float
    high: float
    effect: bool = False  # of an effect: its prior is wide, and stays as it is whatever the model leaves


def unsure(distance: Array) -> Array:
    """Return how unsure priors' means are, in their deviations, where a fit has gone from them by `distance` of these.

    A car that is five deviations from what was expected was expected wrongly.
    """
    return np.maximum(1.0, np.abs(distance))


@dataclass(frozen=True)
class Unknowns:
    """Free parameters θ in a fixed order; a prior is normal with the mean `start` and the deviation `sigma`."""

    names: tuple[str, ...]
    start: Array
    sigma: Array
    low: Array
    high: Array
    specifications: tuple[Parameter, ...]

    def each(self) -> list[Unknown]:
        """Return the unknowns one by one."""
        arrays = (part.tolist() for part in (self.start, self.sigma, self.low, self.high))
        return [Unknown(*row) for row in zip(self.names, *arrays, strict=True)]

    def clip(self, theta: Array) -> Array:
        """Return the nearest values inside the bounds."""
        return np.clip(theta, self.low, self.high)

    def only(self, names: Sequence[str]) -> "Unknowns":
        """Return those of these names."""
        index = [self.names.index(name) for name in names]
        arrays = (self.start[index], self.sigma[index], self.low[index], self.high[index])
        return Unknowns(tuple(names), *arrays, tuple(self.specifications[i] for i in index))

    def settled(self, known: Mapping[str, float]) -> "Unknowns":
        """Return the unknowns with some values settled: no fit moves them."""
        low, high = self.low.copy(), self.high.copy()
        for name, value in known.items():
            low[self.names.index(name)] = high[self.names.index(name)] = value
        return replace(self, low=low, high=high)

    def draw(self, generator: np.random.Generator, spread: float) -> Array:
        """Return a start drawn around the prior's mean, `spread` deviations wide."""
        return self.clip(self.start + spread * self.sigma * generator.standard_normal(len(self.names)))

    def draw_within(self, generator: np.random.Generator) -> Array:
        """Return a start drawn evenly from within one deviation of the prior's mean."""
        return self.clip(self.start + self.sigma * generator.uniform(-1.0, 1.0, len(self.names)))


def choose_unknowns(vehicle: Vehicle, priors: Mapping[str, Any], hold: Sequence[str], configured: Vehicle) -> Unknowns:
    """Return the parameters of `vehicle` that `priors` frees and `hold` does not take back.

    `configured` is the vehicle before measured actuators became inputs; patterns for what it alone has are passed over.

    `priors` maps name patterns to a deviation: a number or {share: …} is a share of the vehicle's value, {absolute: …}
    is in the parameter's unit, null holds it; `within` beside it narrows the bounds, as far as the vehicle lies inside.
    The last pattern that fits a name decides; what an effect takes for known stays. Raises ConfigError.
    """
    table = {name: float(value) for name, value in values(vehicle).items()}
    priors = dict(_flat(priors))
    hold = bounds.words("hold", hold, HELD)
    for pattern in [*priors, *hold]:
        if not fnmatch.filter(values(configured), pattern) and pattern != EFFECTS:
            raise ConfigError(f"no parameter of the vehicle fits '{pattern}'{suggest(pattern, values(configured))}")
    known = specifications(vehicle)
    sigma: dict[str, float] = {}
    limits = {name: (known[name].low, _highest(name, known[name], table)) for name in table}
    for pattern, width in priors.items():
        for name in fnmatch.filter(table, pattern):
            sigma[name] = _deviation(pattern, width, table[name])
            limits[name] = _within(pattern, width, known[name], table[name]) or limits[name]
    for pattern in hold:
        for name in fnmatch.filter(table, pattern):
            sigma[name] = 0.0
    fixed = {f"effects.{name}.{key}" for name, effect in vehicle.effects.items() for key in effect.known}
    names = tuple(name for name in table if sigma.get(name, 0.0) > 0.0 and name not in fixed)
    if not names:
        cure = "leave some out of hold" if hold else "free some in priors, for instance priors.yaw_inertia=0.2"
        raise ConfigError(f"every parameter is held; {cure}")
    return Unknowns(
        names,
        np.array([table[name] for name in names]),
        np.array([sigma[name] for name in names]),
        np.array([limits[name][0] for name in names]),
        np.array([limits[name][1] for name in names]),
        tuple(known[name] for name in names),
    )


def _highest(name: str, specification: Parameter, table: Mapping[str, float]) -> float:
    """Return the upper bound; the centre of gravity stays between the axles."""
    return 0.95 * table["wheelbase"] if name == "l_f" else specification.high


def _flat(priors: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield (dotted pattern, width); an override such as priors.front.p_Hy1=… arrives nested."""
    for key, width in priors.items():
        if isinstance(width, Mapping) and not {"absolute", "share", "within"} & set(width):
            yield from _flat(width, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", width


def _deviation(pattern: str, width: Any, value: float) -> float:
    if width is None:
        return 0.0
    given = width if isinstance(width, Mapping) else {"share": width}
    kind = "absolute" if "absolute" in given else "share"
    if set(given) - {kind, "within"} or not _is_number(given.get(kind)) or given[kind] < 0:
        raise ConfigError(f"priors.{pattern} = {width}: {FORMS}")
    return float(given[kind]) * (abs(value) if kind == "share" else 1.0)


def _within(pattern: str, width: Any, specification: Parameter, value: float) -> tuple[float, float] | None:
    """Return the bounds that `within` narrows, the vehicle's own value inside; None where there is none."""
    within = width.get("within") if isinstance(width, Mapping) else None
    if within is None:
        return None
    if (
        not isinstance(within, Sequence)
        or len(within) != 2
        or not all(map(_is_number, within))
        or within[0] > within[1]
    ):
        raise ConfigError(f"priors.{pattern} = {width}: {FORMS}")
    low, high = max(float(within[0]), specification.low), min(float(within[1]), specification.high)
    return min(low, value), max(high, value)


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
