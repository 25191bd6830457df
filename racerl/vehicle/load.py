"""Vehicles from plain settings: what a `conf/vehicle/*.yaml` or a `model.yaml` says becomes a `Vehicle`."""

import copy
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from racerl import registry
from racerl.documents import read_yaml
from racerl.errors import ConfigError, VehicleError, suggest
from racerl.vehicle import bodies as bodies_package
from racerl.vehicle import effects as effects_package
from racerl.vehicle.actuator import FirstOrder, MotorCurrent
from racerl.vehicle.effects import Effect
from racerl.vehicle.forms import own_form
from racerl.vehicle.parameter import build, check_value
from racerl.vehicle.tyre import MagicFormula
from racerl.vehicle.vehicle import Vehicle

EXAMPLE = "{yaw_damping: {coefficient: 0.15}}"
DRIVES = {"wheel_speed": FirstOrder, "motor_current": MotorCurrent}
COMPONENTS = {"front": MagicFormula, "rear": MagicFormula, "steering": FirstOrder, **DRIVES}


def load_vehicle(settings: Mapping[str, Any], drive: str = "wheel_speed", actuators: bool = True) -> Vehicle:
    """Build a vehicle from settings, or from the file that `settings["file"]` names.

    `drive` is wheel_speed or motor_current; without `actuators` commands act at once. Raises VehicleError.
    """
    if not isinstance(drive, str) or drive not in DRIVES:
        raise VehicleError(f"unknown drive mode '{drive}'{suggest(drive, DRIVES)}")
    if "file" not in settings:
        return _built(settings, drive, actuators)
    whole = _with_file(settings)
    try:
        return _built(whole, drive, actuators)
    except (VehicleError, ConfigError) as error:
        raise type(error)(f"{error} (with vehicle={settings['file']})") from error


def _built(settings: Mapping[str, Any], drive: str, actuators: bool) -> Vehicle:
    parts: dict[str, Any] = {}
    for name, cls in COMPONENTS.items():
        if name not in settings:
            raise VehicleError(f"vehicle: section '{name}' is missing; copy it from conf/vehicle/published.yaml")
        parts[name] = build(cls, settings[name], f"vehicle.{name}")
    own = {key: value for key, value in settings.items() if key not in (*COMPONENTS, "effects", "body")}
    vehicle = Vehicle(
        **_check_own(own),
        body=_check_body(settings.get("body", "")),
        front=parts["front"],
        rear=parts["rear"],
        steering=parts["steering"],
        drive=parts[drive],
        effects=_load_effects(settings.get("effects") or {}),
    )
    for name, effect in vehicle.effects.items():
        if effect.of_speed and drive == "motor_current":
            raise VehicleError(f"vehicle.effects.{name} limits a commanded speed; with sim=motor_current there is none")
    if vehicle.l_f >= vehicle.wheelbase:
        raise VehicleError(f"vehicle.l_f = {vehicle.l_f:g} m: allowed is less than the wheelbase {vehicle.wheelbase:g}")
    return vehicle if actuators else vehicle.without_actuators()


def _check_body(name: Any) -> str:
    if name is None:
        return ""
    if name != "" and name not in registry.choices(bodies_package):
        raise VehicleError(f"vehicle.body = {name}: is unknown{suggest(str(name), registry.choices(bodies_package))}")
    return str(name)


def _check_own(settings: Mapping[str, Any]) -> dict[str, float]:
    known = {
        name: field.metadata["parameter"]
        for name, field in Vehicle.__dataclass_fields__.items()
        if "parameter" in field.metadata
    }
    for key in settings:
        if key not in known:
            raise VehicleError(
                f"vehicle has no parameter '{key}'{suggest(key, {*known, *COMPONENTS, 'effects', 'body'})}"
            )
    for key in ("mass", "yaw_inertia", "wheelbase", "l_f"):
        if key not in settings:
            raise VehicleError(f"vehicle.{key} is missing; give it in {known[key].unit}")
    return {key: check_value(f"vehicle.{key}", known[key], value) for key, value in settings.items()}


def _load_effects(settings: Any) -> dict[str, Effect]:
    if not isinstance(settings, Mapping):
        raise VehicleError(f"vehicle.effects = {settings}: effects with their parameters are expected, as {EXAMPLE}")
    return {
        name: build(registry.lookup(effects_package, name), parameters or {}, f"vehicle.effects.{name}")
        for name, parameters in settings.items()
    }


def vehicle_document(settings: Mapping[str, Any], changes: Mapping[str, float], drive: str) -> dict[str, Any]:
    """Return settings in the form of `conf/vehicle/*.yaml` with the values of `changes` (by dotted name) put in.

    `drive` is the section that the vehicle's `drive` parameters stand in: wheel_speed or motor_current.
    """
    document = copy.deepcopy(dict(_with_file(settings)))
    for name, value in changes.items():
        *path, key = name.split(".")
        section = document
        for part in path:
            section = section[drive if part == "drive" else part]
        section[key] = value
    return document


def _with_file(settings: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the content of `settings["file"]`, if there is one, under what the settings say themselves."""
    if "file" not in settings:
        return settings
    if not isinstance(settings["file"], str | Path) or not str(settings["file"]):
        raise VehicleError(f"vehicle.file = {settings['file']}: a file is expected, as vehicle=model.yaml")
    path = Path(settings["file"])
    return _merged(own_form(read_yaml(path), path), {k: v for k, v in settings.items() if k != "file"})


def _merged(base: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return the base with the changes put in, section by section."""
    merged = dict(base)
    for key, value in changes.items():
        inner = merged.get(key)
        merged[key] = _merged(inner, value) if isinstance(inner, Mapping) and isinstance(value, Mapping) else value
    return merged
