"""Numbers that a user may give: one message for whatever is of the wrong kind or out of range."""

from collections.abc import Sequence
from typing import Any

from racerl.errors import ConfigError


def whole(name: str, value: Any, low: int, high: int) -> int:
    """Return a whole number of `low` … `high`; raise ConfigError for anything else."""
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise ConfigError(f"{name} = {value}: allowed is a whole number, {low} … {high}")
    return value


def number(name: str, value: Any, low: float, high: float, unit: str = "") -> float:
    """Return a number of `low` … `high`; raise ConfigError for anything else, NaN among it."""
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not low <= value <= high:
        raise ConfigError(f"{name} = {value}: allowed is a number, {low:g} … {high:g} {unit}".rstrip())
    return float(value)


def wholes(name: str, value: Any, low: int, high: int) -> list[int]:
    """Return a list of whole numbers of `low` … `high`; raise ConfigError for anything else."""
    if not isinstance(value, list):
        raise ConfigError(f"{name} = {value}: a list of whole numbers is expected")
    return [whole(name, each, low, high) for each in value]


def words(name: str, value: Any, expected: str) -> list[str]:
    """Return texts, of which one may stand alone; raise ConfigError for anything else, saying what is `expected`."""
    listed = [value] if isinstance(value, str) else value
    if not isinstance(listed, list | tuple) or not all(isinstance(each, str) for each in listed):
        raise ConfigError(f"{name} = {value}: {expected}")
    return list(listed)


def pair(name: str, value: Any, low: float, high: float, expected: str) -> tuple[float, float]:
    """Return two numbers of `low` … `high`; raise ConfigError for anything else, which says what is `expected`."""
    if isinstance(value, str) or not isinstance(value, Sequence) or len(value) != 2:
        raise ConfigError(f"{name} = {value}: {expected}")
    return number(name, value[0], low, high), number(name, value[1], low, high)


def switch(name: str, value: Any) -> bool:
    """Return true or false; raise ConfigError for anything else."""
    if not isinstance(value, bool):
        raise ConfigError(f"{name} = {value}: allowed is true or false")
    return value


def layers(name: str, value: Any) -> list[int]:
    """Return the units of a network's hidden layers; raise ConfigError for anything else, none among it."""
    if not 1 <= len(units := wholes(name, value, 1, 65_536)) <= 14:
        raise ConfigError(f"{name} = {value}: allowed are 1 … 14 hidden layers")
    return units
