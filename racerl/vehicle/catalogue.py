"""What is known of every effect: its module's docstring, told apart, and its parameters."""

import inspect
import re
import sys
from dataclasses import dataclass, fields

from racerl import registry
from racerl.vehicle import effects
from racerl.vehicle.effects import Effect
from racerl.vehicle.parameter import Parameter

ASPECTS = ("In words", "Formula", "Source", "In data", "Excited by", "Confused with")


@dataclass(frozen=True)
class Entry:
    """One effect: its class, a sentence about it, the aspects of its docstring, and its parameters by name."""

    name: str
    cls: type[Effect]
    title: str
    aspects: dict[str, str]
    parameters: dict[str, Parameter]


def names() -> list[str]:
    """Return the names of all physical effects, sorted."""
    return [name for name in registry.choices(effects) if registry.lookup(effects, name).physical]  # type: ignore[attr-defined]


def entry(name: str) -> Entry:
    """Return what is known of an effect; raise ConfigError with near names for an unknown one."""
    cls = registry.lookup(effects, name)
    title, _, text = (inspect.getdoc(sys.modules[cls.__module__]) or "").partition("\n\n")
    aspects: dict[str, str] = {}
    for line in text.splitlines():
        label, colon, rest = line.partition(": ")
        if colon and label in ASPECTS:
            aspects[label] = rest
        elif aspects:
            aspects[list(aspects)[-1]] += f" {line.strip()}"
    parameters = {field.name: field.metadata["parameter"] for field in fields(cls)}
    return Entry(name, cls, title, aspects, parameters)


def confused_with(name: str) -> frozenset[str]:
    """Return the effects that the docstring of one names as confused with it, or whose docstrings name it so."""
    return frozenset(other for other in names() if other in _named_by(name) or name in _named_by(other))


def _named_by(name: str) -> set[str]:
    return set(re.findall(r"[a-z_]+", entry(name).aspects["Confused with"]))
