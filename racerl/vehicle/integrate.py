"""Integration of the car's state: classical Runge–Kutta of fourth order with a fixed step."""

from collections.abc import Callable
from typing import Any

from racerl.vehicle.ops import Ops, Scalar
from racerl.vehicle.vehicle import STATE, Vehicle

DELTA, OMEGA = STATE.index("delta"), STATE.index("omega")


def rk4(derivative: Callable[[Any], Any], state: Any, dt: Scalar) -> Any:
    """Return a state, (S, N) or of any other shape, after one step of dt seconds by its derivative."""
    k_1 = derivative(state)
    k_2 = derivative(state + (dt / 2) * k_1)
    k_3 = derivative(state + (dt / 2) * k_2)
    k_4 = derivative(state + dt * k_3)
    return state + (dt / 6) * (k_1 + 2.0 * (k_2 + k_3) + k_4)


def advance(vehicle: Vehicle, state: Any, command: Any, dt: float, steps: int, ops: Ops) -> Any:
    """Return the state after `steps` Runge–Kutta steps, settled."""
    for _ in range(steps):
        state = rk4(lambda now: vehicle.derivative(now, command, ops), state, dt)
    return settled(vehicle, state, command, ops)


def settled(vehicle: Vehicle, state: Any, command: Any, ops: Ops) -> Any:
    """Return the state whose rows δ and ω hold what acts on the car."""
    rows = list(ops.unstack(state))
    delta_ref, drive_ref = ops.unstack(command)
    rows[DELTA] = vehicle.steering.position(rows[DELTA], delta_ref)
    rows[OMEGA] = vehicle.drive.position(rows[OMEGA], drive_ref)
    return ops.stack(rows)
