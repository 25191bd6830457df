"""The car of F1TENTH's gym: a single track of 7 states on tyres whose force grows with the slip angle and never ends.

What is driven is the gym's own derivative and its own controller of speed and steering, as its `RaceCar` does it:
Runge–Kutta steps of 10 ms, steering two steps late. Source: package f110_gym (github.com/f1tenth/f1tenth_gym), of which
only the module of its equations is read, since the rest asks for libraries of 2021. The numbers are those of its
default car, at the configured vehicle's mass and wheelbase: lengths λ, inertia μλ².

It has no wheels: what shows as their speed is the car's, along its own x.
"""

import importlib.util
import math
from collections.abc import Sequence
from functools import partial
from importlib.machinery import SourceFileLoader
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from racerl.errors import VehicleError
from racerl.vehicle.actuator import FirstOrder
from racerl.vehicle.integrate import rk4
from racerl.vehicle.vehicle import Vehicle

STEP = 0.01  # s
LATE = 2  # steps, of the steering
# the default car's; lf, lr and m are the vehicle's
MU, C_SF, C_SR, HEIGHT, YAW_INERTIA, MASS, WHEELBASE = 1.0489, 4.718, 5.4562, 0.074, 0.04712, 3.74, 0.3302
S_MIN, S_MAX, SV_MIN, SV_MAX = -0.4189, 0.4189, -3.2, 3.2
V_SWITCH, A_MAX, V_MIN, V_MAX = 7.319, 9.51, -5.0, 20.0
DELTA, SPEED = 2, 3  # of its state [x, y, δ, v, ψ, r, β]


class Own(NamedTuple):
    """Its state, the steering that is still to act, oldest first, and what is left of a step in s."""

    state: NDArray[np.float64]
    coming: tuple[float, ...]
    left: float


class F1tenthGym:
    """The car."""

    def __init__(self, vehicle: Vehicle) -> None:
        if not isinstance(vehicle.drive, FirstOrder):
            raise VehicleError("body f1tenth_gym is told speeds; give sim=default")
        source = equations()
        self._pid, self._dynamics = source.pid, source.vehicle_dynamics_st
        mass, wheelbase, l_f = float(vehicle.mass), float(vehicle.wheelbase), float(vehicle.l_f)
        scale = wheelbase / WHEELBASE
        inertia = YAW_INERTIA * mass / MASS * scale**2
        own = (MU, C_SF, C_SR, l_f, wheelbase - l_f, HEIGHT * scale, mass, inertia, S_MIN, S_MAX, SV_MIN, SV_MAX)
        self._parameters = (*own, V_SWITCH, A_MAX, V_MIN, V_MAX)  # in the order in which the derivative takes them

    def begin(self, shown: Sequence[float]) -> Own:
        """Return the car in a motion, its steering as it stands for as long as orders are late."""
        x, y, yaw, v_x, v_y, yaw_rate, delta, _ = shown
        sign = -1.0 if v_x < 0.0 else 1.0  # backwards its speed is negative, and its slip small all the same
        speed, slip = sign * math.hypot(v_x, v_y), math.atan2(sign * v_y, abs(v_x))
        state = np.array([x, y, delta, speed, yaw, yaw_rate, slip])
        return Own(state, (delta,) * LATE, 0.0)

    def show(self, own: Own) -> list[float]:
        """Return the rows of STATE."""
        x, y, delta, speed, yaw, yaw_rate, slip = own.state.tolist()
        v_x, v_y = speed * math.cos(slip), speed * math.sin(slip)
        return [x, y, yaw, v_x, v_y, yaw_rate, delta, v_x]

    def advance(self, own: Own, command: tuple[float, float], seconds: float) -> Own:
        """Return the state after a command; what is shorter than a step waits for the next."""
        state, coming, left = own
        left += seconds
        while left > STEP - 1e-9:
            (steer, *later), left = coming, left - STEP
            coming = (*later, command[0])
            acceleration, rate = self._pid(
                command[1], steer, float(state[SPEED]), float(state[DELTA]), SV_MAX, A_MAX, V_MAX, V_MIN
            )
            asked = np.array([rate, acceleration])
            state = rk4(partial(self._rates, asked), state, STEP)
        return Own(state, coming, left)

    def _rates(self, asked: NDArray[np.float64], state: NDArray[np.float64]) -> NDArray[np.float64]:
        rates: NDArray[np.float64] = self._dynamics(state, asked, *self._parameters)
        return rates


def equations() -> ModuleType:
    """Return the gym's module of equations; raise VehicleError where it or its compiler is not installed."""
    package = importlib.util.find_spec("f110_gym")
    places = [
        Path(each) / "envs" / "dynamic_models.py" for each in (package and package.submodule_search_locations) or []
    ]
    try:
        if not (found := [each for each in places if each.is_file()]):
            raise ImportError("No module named 'f110_gym'")
        loader = SourceFileLoader("f110_gym_equations", str(found[0]))
        module = ModuleType(loader.name)
        module.__file__ = loader.path
        loader.exec_module(module)
    except ImportError as error:
        raise VehicleError(
            f"body f1tenth_gym needs the equations of F1TENTH's gym ({error}), which is in no package index: "
            "pip install numba && pip install --no-deps 'git+https://github.com/f1tenth/f1tenth_gym'"
        ) from error
    return module
