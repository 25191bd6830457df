"""The car of F1TENTH's gym: a single track of 7 states on tyres whose force grows with the slip angle and never ends.

What is driven is the gym's own derivative and its own controller of speed and steering, as its `RaceCar` does it:
Euler steps of 10 ms, steering two steps late. Source: package f110_gym (github.com/f1tenth/f1tenth_gym), with the
numbers of its default car; the wheelbase and the mass are those of the configured vehicle.

It has no wheels: what shows as their speed is the car's, along its own x.
"""

import importlib.util
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from racerl.errors import VehicleError
from racerl.vehicle.vehicle import Vehicle

STEP = 0.01  # s
LATE = 2  # steps, of the steering
# the default car's, in the order in which the derivative takes them; lf, lr and m are the vehicle's
MU, C_SF, C_SR, HEIGHT, YAW_INERTIA, MASS = 1.0489, 4.718, 5.4562, 0.074, 0.04712, 3.74
S_MIN, S_MAX, SV_MIN, SV_MAX = -0.4189, 0.4189, -3.2, 3.2
V_SWITCH, A_MAX, V_MIN, V_MAX = 7.319, 9.51, -5.0, 20.0
DELTA, SPEED = 2, 3  # of its state [x, y, δ, v, ψ, r, β]


class Own(NamedTuple):
    """Its state, the steering that is still to act, oldest first, and what is left of a step in s."""

    state: NDArray[np.float64]
    coming: tuple[float, ...]
    left: float


class F1tenthGym:
    """The car, its yaw inertia that of the gym's per mass."""

    def __init__(self, vehicle: Vehicle) -> None:
        if importlib.util.find_spec("f110_gym") is None:
            raise VehicleError(
                "body f1tenth_gym needs F1TENTH's gym, which is in no package index: "
                "pip install 'git+https://github.com/f1tenth/f1tenth_gym'"
            )
        from f110_gym.envs.dynamic_models import pid, vehicle_dynamics_st

        self._pid, self._dynamics = pid, vehicle_dynamics_st
        mass, l_f = float(vehicle.mass), float(vehicle.l_f)
        l_r, inertia = float(vehicle.wheelbase) - l_f, YAW_INERTIA * mass / MASS
        own = (MU, C_SF, C_SR, l_f, l_r, HEIGHT, mass, inertia, S_MIN, S_MAX, SV_MIN, SV_MAX)
        self._parameters = (*own, V_SWITCH, A_MAX, V_MIN, V_MAX)

    def begin(self, shown: Sequence[float]) -> Own:
        """Return the car in a motion, its steering as it stands for as long as orders are late."""
        x, y, yaw, v_x, v_y, yaw_rate, delta, _ = shown
        state = np.array([x, y, delta, math.hypot(v_x, v_y), yaw, yaw_rate, math.atan2(v_y, v_x)])
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
            state = state + STEP * self._dynamics(state, np.array([rate, acceleration]), *self._parameters)
        return Own(state, coming, left)
