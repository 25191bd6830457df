"""The car in the coordinates of a line: where it is beside it, and how it moves along it.

z = (n, ξ, v_x, v_y, r, δ, ω, states of effects[, drive reference, where the action integrates it]) over the line's arc
length s, with ξ the heading against the line. With the car's own derivative f taken at yaw ξ,

    ṡ = f_x/(1 − κn),   ṅ = f_y,   ξ̇ = r − κṡ,   and the other rows as they are.
"""

from typing import Any

import casadi
import numpy as np
import torch
from torch import Tensor

from racerl.env.actions import Action, half_range, middle
from racerl.env.race import Race
from racerl.optimum.corridor import Corridor
from racerl.track.frenet import FrenetFrame, wrap_angle
from racerl.track.track import SPACING
from racerl.vehicle.ops import CasadiOps
from racerl.vehicle.vehicle import STATE, Vehicle

N, XI, V_X, V_Y, YAW_RATE, DELTA, OMEGA = range(7)


def size(vehicle: Vehicle, action: Action) -> int:
    """Return the number of rows of z."""
    return len(vehicle.states) - 1 + action.integrated


def scales(vehicle: Vehicle, action: Action) -> np.ndarray:
    """Return the usual size of every row of z, (Z,)."""
    own = len(vehicle.states) - len(STATE)
    return np.array([0.5, 0.5, 3.0, 1.0, 3.0, 0.5, 3.0] + [1.0] * own + [3.0] * action.integrated)


def motion(vehicle: Vehicle, action: Action, z: Any, u: Any, kappa: Any) -> tuple[Any, list[Any]]:
    """Return ṡ and the rows of ż for CasADi's z and commands u, scaled to ± 1, at a curvature."""
    states = len(vehicle.states)
    drive = z[states - 1] if action.integrated else middle(action) + half_range(action) * u[1]
    state = casadi.vertcat(0, 0, *[z[i] for i in range(XI, states - 1)])
    f = vehicle.derivative(state, casadi.vertcat(u[0] * action.steering_max, drive), CasadiOps())
    speed = f[0] / (1 - kappa * z[N])
    rows = [f[1], f[2] - kappa * speed, *[f[i] for i in range(3, states)]]
    return speed, [*rows, u[1] * action.rate_max] if action.integrated else rows


class LineFrame:
    """The line of a corridor as a frame of its own, for the cars of a race."""

    def __init__(self, corridor: Corridor, race: Race) -> None:
        centre = np.linspace(0.0, race.track.length, len(race.track.x), endpoint=False)
        self._along = torch.as_tensor(corridor.along(centre), dtype=race.dtype)
        self.frame = FrenetFrame(corridor.as_track(SPACING), race.device, race.dtype)

    def locate(self, race: Race, state: Tensor, s: Tensor) -> tuple[Tensor, Tensor]:
        """Return the line's s (N,) and z (N, Z) of states (S, N) at s (N,) of the centreline."""
        near = self._along[(s / race.frame.spacing).round().long() % race.frame.count]
        foot = self.frame.project(state[0], state[1], near)
        rows = [foot.n, wrap_angle(state[2] - foot.yaw), *state[3:]]
        if race.action.integrated:
            rows.append(race.command[1])
        return foot.s, torch.stack(rows, dim=1)
