"""Some of the cars: by number or by mask.

By number, work is done for those cars alone; but to know their numbers, the host waits for the device that has the
mask. By mask, work is done for all cars and kept for some, and nothing waits: cheaper on a GPU, dearer on a CPU.
"""

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class Numbered:
    """Cars by number (K,)."""

    cars: Tensor

    def take(self, table: Tensor) -> Tensor:
        """Return the columns (…, K) of these cars of a table (…, N)."""
        return table.index_select(table.ndim - 1, self.cars)

    def put(self, table: Tensor, columns: Tensor) -> Tensor:
        """Return the table (…, N) with new columns (…, K) of these cars."""
        return table.index_copy(table.ndim - 1, self.cars, columns)


@dataclass(frozen=True)
class Masked:
    """All cars, of which those of the mask (N,) count."""

    mask: Tensor

    @property
    def cars(self) -> Tensor:
        """Return the numbers of the cars that work is done for, (N,)."""
        return torch.arange(len(self.mask), device=self.mask.device)

    def take(self, table: Tensor) -> Tensor:
        """Return the table."""
        return table

    def put(self, table: Tensor, columns: Tensor) -> Tensor:
        """Return the table (…, N) with new columns of the masked cars out of columns (…, N) of all."""
        return torch.where(self.mask, columns, table)


Chosen = Numbered | Masked
