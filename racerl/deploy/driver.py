"""What a policy is to a car: numbers it sees in, references out; nothing of the simulator.

    a = clip(MLP(clip(x / x_max, ±10)), ±1)
    δ_ref = δ_max a_1
    d_ref = clip(d_last + ḋ_max dt a_2, d_min, d_max)   or   (d_max + d_min)/2 + (d_max − d_min)/2 a_2

A recurrent policy has z = LeakyReLU(W x / x_max + b), h' = GRU(z, h), a = clip(MLP(z, h'), ±1) instead.

x are the numbers that the observation names, in their units; d is the drive reference, a wheel speed in m/s or a
current in A, and d_last the one that was commanded before; h is what was remembered, nought at first.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from torch import nn

from racerl.control.networks import SLOPE
from racerl.control.onboard import numbers
from racerl.control.policy import AnyPolicy
from racerl.env.actions import Action, half_range, middle
from racerl.env.observations import OBSERVATION_LIMIT, Observation, Seen

Array = NDArray[np.float32]


@dataclass(frozen=True)
class Cell:
    """A gated recurrent unit of U numbers; weights (3U, U) and biases (3U,): reset, update, new.

    r, u = σ(W z + b + V h + c),  n = tanh(W z + b + r (V h + c)),  h' = (1 − u) n + u h
    """

    weight: Array  # W
    bias: Array  # b
    memory_weight: Array  # V
    memory_bias: Array  # c

    @property
    def units(self) -> int:
        """U."""
        return self.memory_weight.shape[1]

    def __call__(self, value: Array, memory: Array) -> Array:
        """Return the memory (N, U) after the values (N, U)."""
        told = np.split(value @ self.weight.T + self.bias, 3, axis=1)
        known = np.split(memory @ self.memory_weight.T + self.memory_bias, 3, axis=1)
        reset, update = (1.0 / (1.0 + np.exp(-(told[i] + known[i]))) for i in range(2))
        new = np.tanh(told[2] + reset * known[2])
        return new + update * (memory - new)


@dataclass(frozen=True)
class Driver:
    """A policy with the scales of what it sees and does; `layers` are weights (units, inputs) and biases (units,).

    The memory of one that has one comes behind the first layer; what follows takes that layer's values and the memory.
    """

    sees: Sequence[Seen]
    layers: Sequence[tuple[Array, Array]]
    slope: float  # of the LeakyReLU between the layers
    limit: float  # of any number seen, after it was divided by its maximum
    steering_max: float  # rad
    drive_min: float  # m/s or A
    drive_max: float
    gain: float  # of the second output, in the drive's unit
    middle: float | None  # the drive reference at an output of 0; None where outputs are added to the last one
    cell: Cell | None = None

    @classmethod
    def of(cls, policy: AnyPolicy, observation: Observation, action: Action, dt: float) -> "Driver":
        """Return a policy of a fitted observation and an action, for a car that asks it every `dt` seconds."""
        linear = [layer for layer in policy.network.modules() if isinstance(layer, nn.Linear)]
        cells = [layer for layer in policy.network.modules() if isinstance(layer, nn.GRUCell)]
        return cls(
            observation.sees(action),
            [(numbers(layer.weight), numbers(layer.bias)) for layer in linear],
            SLOPE,
            OBSERVATION_LIMIT,
            action.steering_max,
            action.drive_min,
            action.drive_max,
            action.rate_max * dt if action.integrated else half_range(action),
            None if action.integrated else middle(action),
            *(Cell(*map(numbers, (c.weight_ih, c.bias_ih, c.weight_hh, c.bias_hh))) for c in cells),
        )

    @property
    def units(self) -> int:
        """Numbers that are remembered."""
        return self.cell.units if self.cell else 0

    @property
    def maxima(self) -> Array:
        """What the numbers seen are divided by, (O,)."""
        return np.array([each.maximum for each in self.sees], np.float32)

    def __call__(self, seen: Array, last: Array, memory: Array) -> tuple[Array, Array, Array]:
        """Return δ_ref (N,), the drive reference (N,) and the memory (N, U) after what is seen (N, O).

        `last` (N,) are the last drive references, `memory` (N, U) is the last memory.
        """
        value = np.clip(seen / self.maxima, -self.limit, self.limit)
        for number, (weight, bias) in enumerate(self.layers):
            value = value @ weight.T + bias
            if number < len(self.layers) - 1:
                value = np.maximum(value, self.slope * value)
            if self.cell and not number:
                memory = self.cell(value, memory)
                value = np.concatenate([value, memory], axis=1)
        out = np.clip(value, -1.0, 1.0)
        drive = (last if self.middle is None else self.middle) + self.gain * out[:, 1]
        return self.steering_max * out[:, 0], np.clip(drive, self.drive_min, self.drive_max), memory
