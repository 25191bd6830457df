"""What cars remember of the control steps behind them, for observations that look back.

A row (7, N) for each step: v_x, v_y, yaw rate, δ and ω as the driver's sensors showed them, then δ_ref and the drive
command that were given on it. The latest step comes first.
"""

import torch
from torch import Tensor

from racerl.vehicle.vehicle import STATE

STATES = ("v_x", "v_y", "yaw_rate", "delta", "omega")
SIZE = len(STATES) + 2
ROWS = [STATE.index(name) for name in STATES]


def remembered(state: Tensor, command: Tensor) -> Tensor:
    """Return what is kept (7, N) of states (S, N) and the commands (2, N) given in them."""
    return torch.cat([state[ROWS], command])


def filled(state: Tensor, command: Tensor, steps: int) -> Tensor:
    """Return the memory (steps, 7, N) of cars that have always been in states (S, N), with commands (2, N)."""
    return remembered(state, command).expand(steps, -1, -1)


def moved_on(memory: Tensor, state: Tensor, command: Tensor) -> Tensor:
    """Return a memory (P, 7, N) one step later: the commands (2, N) were given in states (S, N), the oldest is lost."""
    return torch.cat([remembered(state, command)[None], memory])[: len(memory)]
