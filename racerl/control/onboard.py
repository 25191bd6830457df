"""A policy for one car, as it runs on board: plain numpy, one observation at a time, nothing allocated on the way."""

import numpy as np
from numpy.typing import NDArray
from torch import Tensor, nn

from racerl.control.networks import SLOPE
from racerl.control.policy import Policy

Array = NDArray[np.float32]


class OnboardPolicy:
    """The same numbers as `Policy`, without the overhead that a batch of one has in torch."""

    def __init__(self, policy: Policy) -> None:
        linear = [layer for layer in policy.network if isinstance(layer, nn.Linear)]
        self._layers = [
            (numbers(layer.weight), numbers(layer.bias), *np.empty((2, layer.out_features), np.float32))
            for layer in linear
        ]
        self._slope = np.float32(SLOPE)
        self._limit = np.float32(1.0)

    def __call__(self, observation: Array) -> Array:
        """Return the action (2,) in [−1, 1] for an observation (O,); the array is overwritten by the next call."""
        value = observation
        for weight, bias, out, scaled in self._layers[:-1]:
            np.dot(weight, value, out=out)
            np.add(out, bias, out=out)
            np.multiply(out, self._slope, out=scaled)
            value = np.maximum(out, scaled, out=out)  # LeakyReLU
        weight, bias, out, _ = self._layers[-1]
        np.dot(weight, value, out=out)
        np.add(out, bias, out=out)
        np.minimum(out, self._limit, out=out)
        return np.maximum(out, -self._limit, out=out)


def numbers(tensor: Tensor) -> Array:
    """Return a tensor's numbers as an array of its own."""
    return np.array(tensor.detach().cpu().numpy(), np.float32, order="C")
