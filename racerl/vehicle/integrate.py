"""Integration of the car's state: classical Runge–Kutta of fourth order with a fixed step."""

from typing import Any

from racerl.vehicle.ops import Ops, Scalar
from racerl.vehicle.vehicle import STATE, Vehicle

DELTA, OMEGA = STATE.index("delta"), STATE.index("omega")


def rk4(vehicle: Vehicle, state: Any, command: Any, dt: Scalar, ops: Ops) -> Any:
    """Return the state (S, N) after one step of dt seconds under a constant command (2, N)."""
    k_1 = vehicle.derivative(state, command, ops)
    k_2 = vehicle.derivative(state + (dt / 2) * k_1, command, ops)
    k_3 = vehicle.derivative(state + (dt / 2) * k_2, command, ops)
    k_4 = vehicle.derivative(state + dt * k_3, command, ops)
    return state + (dt / 6) * (k_1 + 2.0 * (k_2 + k_3) + k_4)


def advance(vehicle: Vehicle, state: Any, command: Any, dt: float, steps: int, ops: Ops) -> Any:
    """Return the state after `steps` Runge–Kutta steps; rows δ and ω hold what acts on the car."""
    for _ in range(steps):
        state = rk4(vehicle, state, command, dt, ops)
    rows = list(ops.unstack(state))
    delta_ref, drive_ref = ops.unstack(command)
    rows[DELTA] = vehicle.steering.position(rows[DELTA], delta_ref)
    rows[OMEGA] = vehicle.drive.position(rows[OMEGA], drive_ref)
    return ops.stack(rows)
