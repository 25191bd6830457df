"""Cars of every kind, and random states for them."""

from functools import cache
from typing import Any

import casadi
import numpy as np
import pytest
import torch

from racerl.assemble import build_vehicle
from racerl.config import compose_settings
from racerl.documents import conf_folder, read_yaml
from racerl.vehicle import catalogue
from racerl.vehicle.integrate import advance
from racerl.vehicle.ops import CasadiOps
from racerl.vehicle.vehicle import Vehicle

EFFECTS = catalogue.names()
ALL = f"+vehicle/effect=[{','.join(EFFECTS)}]"
DRIVES = ["sim=default", "sim=no_actuators", "sim=motor_current"]


@cache
def make_car(*overrides: str) -> Vehicle:
    return build_vehicle(settings_of(*overrides))


@cache
def settings_of(*overrides: str) -> dict[str, Any]:
    """Return composed settings; a single effect is put in as it is packaged, as composing them all takes a while."""
    effect = overrides[0].removeprefix("+vehicle/effect=") if len(overrides) == 1 else ""
    if effect not in EFFECTS:
        return compose_settings("train", overrides)
    plain, packaged = settings_of(), read_yaml(conf_folder() / "vehicle" / "effect" / f"{effect}.yaml")
    return {**plain, "vehicle": {**plain["vehicle"], "effects": {effect: packaged}}}


@pytest.fixture(scope="session", params=[*DRIVES, *(f"+vehicle/effect={name}" for name in EFFECTS), ALL])
def any_car(request: pytest.FixtureRequest) -> Vehicle:
    return make_car(request.param)


@pytest.fixture(scope="session", params=[*DRIVES, "+vehicle/effect=tyre_relaxation", ALL])
def built_car(request: pytest.FixtureRequest) -> Vehicle:
    """Every kind of car that takes a compiler seconds to build.

    That of all effects at once has softer tyres: the default car's wheels then shake, which single precision spoils.
    """
    return make_car(request.param, *(["vehicle=published"] if request.param == ALL else []))


@pytest.fixture(scope="session")
def car() -> Vehicle:
    return make_car()


def random_states(car: Vehicle, count: int, seed: int = 0, slow: bool = False) -> tuple[torch.Tensor, torch.Tensor]:
    """Return states (S, N) and commands (2, N), from standstill to racing, in double precision."""
    draw: Any = torch.Generator().manual_seed(seed)

    def uniform(low: float, high: float) -> torch.Tensor:
        return low + (high - low) * torch.rand(count, generator=draw, dtype=torch.float64)

    rows = {name: uniform(-0.3, 0.3) for name in car.states}
    fastest = 0.4 if slow else 6.0
    rows |= {"yaw": uniform(-3, 3), "v_x": uniform(-fastest / 4, fastest), "v_y": uniform(-1, 1)}
    rows |= {"yaw_rate": uniform(-4, 4), "delta": uniform(-0.5, 0.5)}
    rows["omega"] = rows["v_x"] * uniform(0.5, 1.5) + uniform(-0.2, 0.2)
    command = torch.stack([uniform(-0.5, 0.5), uniform(0.01, 7.0)])
    return torch.stack([rows[name] for name in car.states]), command


def travel(car: Vehicle, state: torch.Tensor, command: torch.Tensor, dt: float, steps: int) -> torch.Tensor:
    """Return the states (steps, S, N) after each of many Runge–Kutta steps; eager torch takes seconds for them."""
    count = state.shape[1]
    x, u = casadi.SX.sym("x", len(car.states)), casadi.SX.sym("u", 2)
    step = casadi.Function("step", [x, u], [advance(car, x, u, dt, 1, CasadiOps())])
    found = step.map(count).mapaccum(steps)(state.numpy(), np.tile(command.numpy(), steps))
    return torch.as_tensor(np.array(found).reshape(len(car.states), steps, count).transpose(1, 0, 2))
