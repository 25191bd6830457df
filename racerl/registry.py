"""Names to classes: one module per observation, action, effect or controller.

A module `speed_rate.py` in a registry package holds one class `SpeedRate`, a frozen dataclass whose fields are the
keys of its YAML. Nothing else has to be edited to add one. Names are looked up among the files that are there, so a
config can never import anything else.
"""

import dataclasses
import importlib
import pkgutil
from collections.abc import Mapping
from types import ModuleType
from typing import Any

from racerl.errors import ConfigError, suggest


def choices(package: ModuleType) -> list[str]:
    """Return the names that a registry package offers, sorted."""
    return sorted(info.name for info in pkgutil.iter_modules(package.__path__) if not info.name.startswith("_"))


def lookup(package: ModuleType, name: str) -> type:
    """Return the class that `name` stands for; raise ConfigError with near names otherwise."""
    kind = package.__name__.rsplit(".", 1)[-1].rstrip("s")
    if name not in choices(package):
        raise ConfigError(f"unknown {kind} '{name}'{suggest(name, choices(package))}")
    module = importlib.import_module(f"{package.__name__}.{name}")
    cls: type = getattr(module, "".join(part.capitalize() for part in name.split("_")))
    return cls


def create(package: ModuleType, settings: Mapping[str, Any]) -> Any:
    """Build the object that `settings["name"]` names from the remaining keys."""
    if "name" not in settings:
        raise ConfigError(f"{dict(settings)}: has no 'name'{suggest('', choices(package))}")
    cls = lookup(package, settings["name"])
    return construct(cls, {key: value for key, value in settings.items() if key != "name"}, settings["name"])


def construct(cls: type, settings: Mapping[str, Any], where: str) -> Any:
    """Build a dataclass from a mapping; raise ConfigError for unknown, missing or mistyped keys."""
    if not isinstance(settings, Mapping):
        raise ConfigError(f"{where} = {settings}: settings with their values are expected")
    fields = {field.name: field for field in dataclasses.fields(cls) if field.init}
    for key in settings:
        if key not in fields:
            raise ConfigError(f"{where} has no setting '{key}'{suggest(key, fields)}")
    for key, field in fields.items():
        required = field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING
        if required and key not in settings:
            raise ConfigError(f"{where}.{key} is missing; give it a value")
    try:
        return cls(**settings)
    except (TypeError, ValueError) as error:
        raise ConfigError(f"{where}: {error}") from error
