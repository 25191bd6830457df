"""Random draws of a race, from explicit generators: one for all cars, or one per car.

With one generator per car, what happens to a car depends on its own seed only, not on its neighbours.
"""

from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor


class Dice:
    """Uniform and normal draws for some cars, of shape (rows, K)."""

    def __init__(self, seeds: Sequence[int], count: int, device: torch.device, dtype: torch.dtype) -> None:
        self.count, self.device, self.dtype = count, device, dtype
        self.generators = [torch.Generator(device).manual_seed(seed) for seed in seeds]

    def uniform(self, rows: int, cars: Tensor) -> Tensor:
        """Return draws from [0, 1) for the cars of these numbers (K,)."""
        return self._draw(torch.rand, rows, cars)

    def normal(self, rows: int, cars: Tensor) -> Tensor:
        """Return draws from N(0, 1) for the cars of these numbers (K,)."""
        return self._draw(torch.randn, rows, cars)

    def _draw(self, source: Callable[..., Tensor], rows: int, cars: Tensor) -> Tensor:
        kind: dict[str, Any] = {"device": self.device, "dtype": self.dtype}
        if len(self.generators) == 1:
            return source(rows, len(cars), generator=self.generators[0], **kind)
        return torch.stack([source(rows, generator=self.generators[car], **kind) for car in cars.tolist()], dim=1)

    def snapshot(self) -> Tensor:
        """Return the state of all generators, (G, bytes)."""
        return torch.stack([generator.get_state() for generator in self.generators])

    def restore(self, states: Tensor) -> None:
        """Continue from a snapshot."""
        for generator, state in zip(self.generators, states.cpu(), strict=True):
            generator.set_state(state.clone())  # torch 2.13 crashes on a row of a table
