"""Observations by their running mean and deviation, while a policy learns; folded into its first layer afterwards."""

import copy
from typing import cast

import torch
from torch import Tensor, nn

CONSTANT = 1e-6  # variance below which a number counts as constant and is left as it is


class Normaliser:
    """z = (o − mean)/deviation over all observations so far; the identity before the first."""

    def __init__(self, size: int, device: torch.device) -> None:
        self.count = torch.zeros((), device=device)
        self.mean, self.variance = torch.zeros(size, device=device), torch.ones(size, device=device)

    def __call__(self, observations: Tensor) -> Tensor:
        """Return observations (…, O), normalised."""
        mean, deviation = self._scale()
        return (observations - mean) / deviation

    def update(self, mean: Tensor, variance: Tensor, count: int) -> None:
        """Take in the moments (O,) of `count` more observations."""
        total = self.count + count
        apart, share = mean - self.mean, count / total
        self.variance = self.variance + share * (variance - self.variance + (1 - share) * apart**2)
        self.mean = self.mean + share * apart
        self.count = total

    def fold(self, network: nn.Sequential) -> nn.Sequential:
        """Return a copy of a network of normalised observations that takes them as they are."""
        mean, deviation = self._scale()
        folded = copy.deepcopy(network)
        first = cast(nn.Linear, folded[0])
        with torch.no_grad():
            first.weight.div_(deviation)
            first.bias.sub_(first.weight @ mean)
        return folded

    def _scale(self) -> tuple[Tensor, Tensor]:
        constant = self.variance < CONSTANT
        return self.mean.masked_fill(constant, 0.0), self.variance.sqrt().masked_fill(constant, 1.0)


def moments(observations: Tensor) -> tuple[Tensor, Tensor, int]:
    """Return mean (O,), variance (O,) and number of observations (T, N, O)."""
    flat = observations.flatten(0, 1)
    mean = flat.mean(dim=0)
    return mean, (flat - mean).square_().mean(dim=0), len(flat)
