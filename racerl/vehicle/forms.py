"""Vehicles in the forms that other racing stacks keep them in, out and in.

F1TENTH's gym (CommonRoad's single-track model): side forces μ C_S F_z α without a peak, C_S in 1/rad, loads by the
height h. ForzaETH's race stack: μ D F_z sin(C atan(B α − E (B α − atan(B α)))), [B, C, D, E] per axle. Both hold side
forces at static loads; what they do not know, on reading, is the `published` car's: the tyres lengthways and under
combined slip, the drive and the drag. Slips are tan α here, α there: alike up to some 0.3 rad.
"""

import logging
from collections.abc import Mapping
from functools import cache
from math import atan, sin
from pathlib import Path
from typing import Any, NamedTuple

from racerl.documents import conf_folder, read_yaml
from racerl.errors import VehicleError
from racerl.vehicle.parameter import values
from racerl.vehicle.vehicle import GRAVITY, Vehicle

LOADED = "longitudinal_load_transfer"
HEIGHT = f"effects.{LOADED}.height"
KEYS = ("F_z0", "p_Cy1", "p_Dy1", "p_Dy2", "p_Ey1", "p_Ey2", "p_Ky1", "p_Ky2", "p_Ky4")
GYM = {"mu", "C_Sf", "C_Sr", "lf", "lr", "m", "I"}
SHIFTS = ("p_Hy1", "p_Hy2", "p_Vy1", "p_Vy2", "p_Ey3")  # of the side force, which neither form has
PACEJKA = {"C_Pf", "C_Pr", "mu", "m", "I_z", "l_f", "l_r"}
BASE = "published"
SLOPE = sin(2.0 * atan(0.5))  # K_yα/(p_Ky1 F_z) at the nominal load, by the usual p_Ky2 and p_Ky4
log = logging.getLogger(__name__)


class Axle(NamedTuple):
    """Side forces of an axle under a load in N: peak over the load without the floor's friction, stiffness in N/rad."""

    load: float
    shape: float
    peak: float
    curvature: float
    stiffness: float

    @classmethod
    def of(cls, tyre: Mapping[str, float], load: float) -> "Axle":
        """Return a tyre's side forces (4.E19–4.E30) under a load."""
        extra = load / tyre["F_z0"] - 1.0
        stiffness = tyre["p_Ky1"] * tyre["F_z0"] * sin(tyre["p_Ky4"] * atan(load / (tyre["p_Ky2"] * tyre["F_z0"])))
        peak, curvature = (tyre[f"p_{name}1"] + tyre[f"p_{name}2"] * extra for name in ("Dy", "Ey"))
        if peak <= 0.0:
            raise VehicleError(f"p_Dy1, p_Dy2: the side force has no peak at the car's own load of {load:.0f} N")
        return cls(load, tyre["p_Cy1"], peak, min(curvature, 1.0), stiffness)

    def coefficients(self, friction: float) -> list[float]:
        """Return B, C, D, E."""
        B = self.stiffness / (self.shape * friction * self.peak * self.load)
        return [B, self.shape, self.peak, self.curvature]


def gym_form(vehicle: Vehicle) -> dict[str, float]:
    """Return the parameters that F1TENTH's gym takes for a car; its limits are not the car's and left out."""
    table, front, rear = _axles(vehicle)
    mu = table["friction"] * (front.peak * front.load + rear.peak * rear.load) / (front.load + rear.load)
    return {
        "mu": mu,
        "C_Sf": front.stiffness / (mu * front.load),
        "C_Sr": rear.stiffness / (mu * rear.load),
        "lf": table["l_f"],
        "lr": table["wheelbase"] - table["l_f"],
        "h": table.get(HEIGHT, 0.0),
        "m": table["mass"],
        "I": table["yaw_inertia"],
    }


def pacejka_form(vehicle: Vehicle, name: str) -> dict[str, Any]:
    """Return the parameters of ForzaETH's Pacejka model; its throttle and drag fits have no counterpart here."""
    table, front, rear = _axles(vehicle)
    mu = table["friction"]
    return {
        "model_name": name,
        "tire_model": "pacejka",
        "C_Pf": front.coefficients(mu),
        "C_Pr": rear.coefficients(mu),
        "mu": mu,
        "m": table["mass"],
        "I_z": table["yaw_inertia"],
        "l_f": table["l_f"],
        "l_r": table["wheelbase"] - table["l_f"],
        "l_wb": table["wheelbase"],
        "h_cg": table.get(HEIGHT, 0.0),
        "tau_steer": table["steering.time_constant"],
    }


def lacking(vehicle: Vehicle) -> list[str]:
    """Return what a vehicle has and neither form: effects but load transfer, tyres that differ from side to side."""
    table = values(vehicle)
    shifted = [f"{axle}.{key}" for axle in ("front", "rear") for key in SHIFTS if table.get(f"{axle}.{key}")]
    return [*(name for name in vehicle.effects if name != LOADED), *shifted]


def own_form(document: Mapping[str, Any], path: Path) -> Mapping[str, Any]:
    """Return a vehicle's document in the form of `conf/vehicle/*.yaml`, whosever form it has.

    Raises VehicleError where a number is missing, none, or no car's.
    """
    if "C_Pf" in document:
        _warn(path, "ForzaETH's", "")
        return _from_pacejka(_Numbers(document, path, PACEJKA, "ForzaETH's"))
    if {"C_Sf", "lf"} <= set(document):
        _warn(path, "F1TENTH's gym's", "the bend of its side forces, which end at mu, ")
        return _from_gym(_Numbers(document, path, GYM, "F1TENTH's gym's"))
    return document


@cache
def _warn(path: Path, whose: str, more: str) -> None:
    """Say what such a file does not know, once."""
    log.warning(
        "%s: a vehicle in %s form; %sits tyres lengthways, drive and drag are of vehicle=%s", path, whose, more, BASE
    )


class _Numbers:
    """The numbers of a file."""

    def __init__(self, document: Mapping[str, Any], path: Path, needed: set[str], whose: str) -> None:
        self.document, self.path = document, path
        if missing := sorted(needed - set(document)):
            raise VehicleError(f"{path}: has {whose} form, but lacks {', '.join(missing)}")

    def number(self, key: str, usual: float | None = None) -> float:
        """Return a number, the usual one where it is not there."""
        return self._checked(key, self.document[key] if usual is None else self.document.get(key, usual))

    def positive(self, key: str) -> float:
        """Return a number above zero."""
        value = self.number(key)
        if value <= 0.0:
            raise VehicleError(f"{self.path}: {key} = {value:g}: more than 0 is expected")
        return value

    def coefficients(self, key: str) -> list[float]:
        """Return B, C, D, E."""
        row = self.document[key]
        if not isinstance(row, list) or len(row) != 4:
            raise VehicleError(f"{self.path}: {key} = {row}: four numbers B, C, D, E are expected")
        return [self._checked(f"{key}[{i}]", each) for i, each in enumerate(row)]

    def _checked(self, key: str, value: Any) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise VehicleError(f"{self.path}: {key} = {value!r}: a number is expected")
        return float(value)


def _from_pacejka(file: _Numbers) -> dict[str, Any]:
    mu = file.positive("mu")
    vehicle = _body(file.positive("m"), file.positive("I_z"), file.positive("l_f"), file.positive("l_r"), mu)
    for axle, key in (("front", "C_Pf"), ("rear", "C_Pr")):
        B, C, D, E = file.coefficients(key)
        vehicle[axle] |= {"p_Cy1": C, "p_Dy1": D, "p_Ey1": E, "p_Ky1": B * C * mu * D / SLOPE}
    usual = vehicle["steering"]["time_constant"]
    vehicle["steering"] = {"time_constant": file.number("tau_steer", usual)}
    return _loaded(vehicle, file.number("h_cg", 0.0))


def _from_gym(file: _Numbers) -> dict[str, Any]:
    mu = file.positive("mu")
    vehicle = _body(file.positive("m"), file.positive("I"), file.positive("lf"), file.positive("lr"), mu)
    for axle, key in (("front", "C_Sf"), ("rear", "C_Sr")):
        vehicle[axle] |= {"p_Dy1": 1.0, "p_Ky1": file.positive(key) * mu / SLOPE}
    return _loaded(vehicle, file.number("h", 0.0))


def _body(mass: float, inertia: float, l_f: float, l_r: float, mu: float) -> dict[str, Any]:
    """Return the base car's document with another body: nominal loads are its own, grip lengthways the base car's."""
    vehicle = read_yaml(conf_folder() / "vehicle" / f"{BASE}.yaml")
    usual = vehicle["friction"]
    vehicle |= {"mass": mass, "yaw_inertia": inertia, "wheelbase": l_f + l_r, "l_f": l_f, "friction": mu}
    for axle, arm in (("front", l_r), ("rear", l_f)):
        tyre = vehicle[axle]
        load = mass * GRAVITY * arm / (l_f + l_r)
        vehicle[axle] = {**tyre, "F_z0": load, "p_Dx1": tyre["p_Dx1"] * usual / mu}
    return vehicle


def _loaded(vehicle: dict[str, Any], height: float) -> dict[str, Any]:
    return {**vehicle, "effects": {LOADED: {"height": height}}} if height else vehicle


def _axles(vehicle: Vehicle) -> tuple[dict[str, float], Axle, Axle]:
    """Return the vehicle's numbers by name, and its axles as they are loaded when it stands."""
    table = {name: float(value) for name, value in values(vehicle).items()}
    weight = table["mass"] * GRAVITY / table["wheelbase"]
    loads = {"front": weight * (table["wheelbase"] - table["l_f"]), "rear": weight * table["l_f"]}
    front, rear = (Axle.of({key: table[f"{name}.{key}"] for key in KEYS}, load) for name, load in loads.items())
    return table, front, rear
