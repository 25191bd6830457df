"""What a driver sees where a car's sensors are wrong or late.

seen(t) = measure(true)(t − T), T the latency of each channel; between control steps states are interpolated.
"""

import math
from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

from racerl import bounds
from racerl.errors import ConfigError, suggest
from racerl.vehicle.ops import TORCH
from racerl.vehicle.vehicle import STATE, Vehicle


def check_estimate(key: str, noise: Any) -> None:
    """Raise ConfigError for noise of what a driver sees that is no deviation, 0 … 10, per state."""
    if not isinstance(noise, Mapping):
        raise ConfigError(f"{key} = {noise}: a mapping from states to deviations is expected, such as {{v_y: 0.02}}")
    for state, deviation in noise.items():
        if state not in STATE:
            raise ConfigError(f"{key} has no state '{state}'{suggest(state, STATE)}")
        bounds.number(f"{key}.{state}", deviation, 0.0, 10.0)


def samples(vehicle: Vehicle, period: float, noisy: bool = False) -> int:
    """Return how many shown states must be known, one per period; 0 where sensors show the truth at once.

    Latencies may be half as long again, where they are randomized.
    """
    true = {name: torch.zeros(1) for name in STATE}
    honest = all(value is true[name] for name, value in vehicle.measured(true, TORCH).items())
    longest = max((abs(float(late)) for late in vehicle.latencies().values()), default=0.0)
    return 0 if honest and longest == 0.0 and not noisy else 2 + math.floor(1.5 * longest / period)


def shown(vehicle: Vehicle, state: Tensor) -> Tensor:
    """Return what sensors show of states (S, N), without latency, (8, N)."""
    channels = vehicle.measured(dict(zip(STATE, state[: len(STATE)].unbind(0), strict=True)), TORCH)
    return torch.stack([channels[name].expand(state.shape[1]) for name in STATE])


def seen(vehicle: Vehicle, past: Tensor, period: float) -> Tensor:
    """Return what is seen now, (8, N), of past shown states (K, 8, N), newest first."""
    late = vehicle.latencies()
    rows = []
    for i, name in enumerate(STATE):
        delay = late.get(name, 0.0)
        age = delay / period if isinstance(delay, Tensor) else past.new_full((), delay / period)
        age = age.clamp(0.0, len(past) - 1.0).expand(past.shape[2])
        whole = age.floor().long().clamp(max=len(past) - 2)
        newer, older = (past[:, i].gather(0, (whole + k)[None])[0] for k in (0, 1))
        rows.append(newer + (age - whole) * (older - newer))
    return torch.stack(rows)
