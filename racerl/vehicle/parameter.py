"""Parameters of a vehicle: dataclass fields that carry a unit, physical bounds and a meaning.

A component is a frozen dataclass; components nest. A parameter is addressed by its dotted name, for instance
`mass` or `front.p_Dy1`. Its value is a float, a tensor of shape (N,) with one value per car, or a CasADi symbol.
"""

import dataclasses
import fnmatch
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

from racerl.errors import ConfigError, VehicleError, suggest
from racerl.vehicle.ops import Scalar

Component = TypeVar("Component")


@dataclass(frozen=True)
class Parameter:
    """What is known of a parameter beside its value."""

    unit: str
    low: float
    high: float
    meaning: str


def parameter(unit: str, low: float, high: float, meaning: str, default: float | None = None) -> Any:
    """Declare a dataclass field as a parameter; without a default it has to be given."""
    metadata = {"parameter": Parameter(unit, low, high, meaning)}
    return (
        dataclasses.field(metadata=metadata)
        if default is None
        else dataclasses.field(default=default, metadata=metadata)
    )


def _walk(component: Any, prefix: str = "") -> Iterator[tuple[str, Parameter, Scalar]]:
    for field in dataclasses.fields(component):
        value = getattr(component, field.name)
        if "parameter" in field.metadata:
            yield f"{prefix}{field.name}", field.metadata["parameter"], value
        elif dataclasses.is_dataclass(value):
            yield from _walk(value, f"{prefix}{field.name}.")
        elif isinstance(value, Mapping):
            for key, item in value.items():
                yield from _walk(item, f"{prefix}{field.name}.{key}.")


def specifications(component: Any) -> dict[str, Parameter]:
    """Return unit, bounds and meaning of every parameter by dotted name."""
    return {name: specification for name, specification, _ in _walk(component)}


def values(component: Any) -> dict[str, Scalar]:
    """Return every parameter's value by dotted name."""
    return {name: value for name, _, value in _walk(component)}


def matching(patterns: Iterable[str], known: Mapping[str, Any], where: str) -> list[str]:
    """Return the names that patterns stand for, one behind the other; raise ConfigError when one matches nothing."""
    names = []
    for pattern in patterns:
        if not (matches := fnmatch.filter(known, pattern)):
            raise ConfigError(f"{where}: '{pattern}' matches no vehicle parameter{suggest(pattern, known)}")
        names += matches
    return names


def replace_values(component: Component, changes: Mapping[str, Scalar]) -> Component:
    """Return the component with some parameters replaced, by dotted name."""
    direct: dict[str, Any] = {}
    nested: dict[str, dict[str, Scalar]] = {}
    for name, value in changes.items():
        head, _, rest = name.partition(".")
        if rest:
            nested.setdefault(head, {})[rest] = value
        else:
            direct[head] = value
    for head, inner in nested.items():
        child = getattr(component, head)
        direct[head] = _replace_items(child, inner) if isinstance(child, Mapping) else replace_values(child, inner)
    return dataclasses.replace(component, **direct)  # type: ignore[type-var]


def _replace_items(items: Mapping[str, Any], changes: Mapping[str, Scalar]) -> dict[str, Any]:
    changed = dict(items)
    for name, value in changes.items():
        key, _, rest = name.partition(".")
        changed[key] = replace_values(changed[key], {rest: value})
    return changed


def check_value(name: str, specification: Parameter, value: Any) -> float:
    """Return the value as a float; raise VehicleError when it is no number or outside its bounds."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise VehicleError(
            f"{name}: {value!r} is not a number ({specification.meaning}, {specification.unit or 'no unit'})"
        )
    if not specification.low <= value <= specification.high:
        allowed = f"{specification.low:g} … {specification.high:g} {specification.unit}".rstrip()
        raise VehicleError(f"{name} = {value:g}: allowed is {allowed} ({specification.meaning})")
    return float(value)


def build(cls: type[Component], settings: Any, where: str) -> Component:
    """Build a component of plain parameters from a mapping, checking names and bounds."""
    if not isinstance(settings, Mapping):
        raise VehicleError(f"{where}: {settings!r} is not a mapping of parameters")
    fields = {field.name: field for field in dataclasses.fields(cls)}  # type: ignore[arg-type]
    for key in settings:
        if key not in fields:
            raise VehicleError(f"{where} has no parameter '{key}'{suggest(key, fields)}")
    missing = [key for key, field in fields.items() if field.default is dataclasses.MISSING and key not in settings]
    if missing:
        raise VehicleError(f"{where}: {', '.join(missing)} missing; give a value for each")
    return cls(
        **{
            key: check_value(f"{where}.{key}", fields[key].metadata["parameter"], value)
            for key, value in settings.items()
        }
    )
