"""What a policy is to a car: numbers it sees in, references out; nothing of the simulator.

    a = clip(MLP(clip(x / x_max, ±10)), ±1)
    δ_ref = δ_max a_1
    d_ref = clip(d_last + ḋ_max dt a_2, d_min, d_max)   or   (d_max + d_min)/2 + (d_max − d_min)/2 a_2

x are the numbers that the observation names, in their units; d is the drive reference, a wheel speed in m/s or a
current in A, and d_last the one that was commanded before.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from torch import Tensor, nn

from racerl.control.policy import SLOPE, Policy
from racerl.env.actions import Action, half_range, middle
from racerl.env.observations import OBSERVATION_LIMIT, Observation, Seen

Array = NDArray[np.float32]


@dataclass(frozen=True)
class Driver:
    """A policy with the scales of what it sees and does; `layers` are weights (units, inputs) and biases (units,)."""

    sees: Sequence[Seen]
    layers: Sequence[tuple[Array, Array]]
    slope: float  # of the LeakyReLU between the layers
    limit: float  # of any number seen, after it was divided by its maximum
    steering_max: float  # rad
    drive_min: float  # m/s or A
    drive_max: float
    gain: float  # of the second output, in the drive's unit
    middle: float | None  # the drive reference at an output of 0; None where outputs are added to the last one

    @classmethod
    def of(cls, policy: Policy, observation: Observation, action: Action, dt: float) -> "Driver":
        """Return a policy of a fitted observation and an action, for a car that asks it every `dt` seconds."""
        linear = [layer for layer in policy.network if isinstance(layer, nn.Linear)]
        return cls(
            observation.sees(action),
            [(_numbers(layer.weight), _numbers(layer.bias)) for layer in linear],
            SLOPE,
            OBSERVATION_LIMIT,
            action.steering_max,
            action.drive_min,
            action.drive_max,
            action.rate_max * dt if action.integrated else half_range(action),
            None if action.integrated else middle(action),
        )

    @property
    def maxima(self) -> Array:
        """What the numbers seen are divided by, (O,)."""
        return np.array([each.maximum for each in self.sees], np.float32)

    def __call__(self, seen: Array, last: Array) -> tuple[Array, Array]:
        """Return δ_ref (N,) and the drive reference (N,) for what is seen (N, O) and the last drive references (N,)."""
        value = np.clip(seen / self.maxima, -self.limit, self.limit)
        for weight, bias in self.layers[:-1]:
            value = value @ weight.T + bias
            value = np.maximum(value, self.slope * value)
        weight, bias = self.layers[-1]
        out = np.clip(value @ weight.T + bias, -1.0, 1.0)
        drive = (last if self.middle is None else self.middle) + self.gain * out[:, 1]
        return self.steering_max * out[:, 0], np.clip(drive, self.drive_min, self.drive_max)


def _numbers(tensor: Tensor) -> Array:
    return np.array(tensor.detach().cpu().numpy(), np.float32, order="C")
