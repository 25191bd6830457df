"""What policies are made of: linear layers, LeakyReLU between them, and a gated recurrent unit where they remember.

A recurrent network has z = LeakyReLU(W o + b), h' = GRU(z, h), action = layers of (z, h'); h is nought where an episode
begins.
"""

from collections.abc import Callable

import torch
from torch import Tensor, nn
from torch.nn.functional import leaky_relu

Map = tuple[Tensor, Tensor]  # weights (out, in) and biases (out,) of x ↦ W x + b
Apply = Callable[[int, Tensor], Tensor]  # a network's map of that number, or what stands in for it, of inputs (N, in)

SLOPE = 0.2  # of the LeakyReLU


def build_network(sizes: list[int]) -> nn.Sequential:
    """Return linear layers of these sizes with LeakyReLU(0.2) between them."""
    layers: list[nn.Module] = []
    for i in range(len(sizes) - 1):
        layers += [nn.Linear(sizes[i], sizes[i + 1]), nn.LeakyReLU(SLOPE)]
    return nn.Sequential(*layers[:-1])


def maps(network: nn.Module) -> list[Map]:
    """Return a network's linear maps, in the order in which `walk` applies them."""
    if isinstance(network, RecurrentNetwork):
        cell = network.cell
        own = [(cell.weight_ih, cell.bias_ih), (cell.weight_hh, cell.bias_hh)]
        return [*maps(network.reads), *own, *maps(network.gives)]
    return [(layer.weight, layer.bias) for layer in network.children() if isinstance(layer, nn.Linear)]


def walk(network: nn.Module, observation: Tensor, memory: Tensor, apply: Apply) -> tuple[Tensor, Tensor]:
    """Return mean actions and the next memory as the network gives them, were its linear maps `apply`."""
    if isinstance(network, RecurrentNetwork):
        seen = leaky_relu(apply(0, observation), SLOPE)
        memory = _remembered(apply(1, seen), apply(2, memory), memory)
        return apply(4, leaky_relu(apply(3, torch.cat([seen, memory], dim=-1)), SLOPE)), memory
    count = len(maps(network))
    x = observation
    for i in range(count):
        x = apply(i, x)
        x = leaky_relu(x, SLOPE) if i < count - 1 else x
    return x, memory


class RecurrentNetwork(nn.Module):
    """From observations and a memory of some units to mean actions and the memory after them."""

    def __init__(self, inputs: int, units: int, outputs: int) -> None:
        super().__init__()
        self.sizes = [inputs, units, outputs]
        self.reads = nn.Sequential(nn.Linear(inputs, units), nn.LeakyReLU(SLOPE))
        self.cell = nn.GRUCell(units, units)
        self.gives = build_network([2 * units, units, outputs])

    def forward(self, observation: Tensor, memory: Tensor) -> tuple[Tensor, Tensor]:
        """Return mean actions (N, A) and the next memory (N, U) for observations (N, O) and a memory (N, U)."""
        seen = self.reads(observation)
        memory = self.cell(seen, memory)
        return self.gives(torch.cat([seen, memory], dim=-1)), memory

    def unroll(self, observations: Tensor, begun: Tensor, memory: Tensor) -> Tensor:
        """Return the mean actions (T, N, A) for observations (T, N, O) one after another, from a memory (N, U).

        `begun` (T, N) says where an episode begins, before which nothing is remembered.
        """
        seen = self.reads(observations)
        memories = []
        for now, new in zip(seen, begun, strict=True):
            memory = self.cell(now, forgotten(memory, new))
            memories.append(memory)
        actions: Tensor = self.gives(torch.cat([seen, torch.stack(memories)], dim=-1))
        return actions


def forgotten(memory: Tensor, begun: Tensor) -> Tensor:
    """Return a memory (N, U) that is nought for the cars whose episode begins (N,)."""
    return memory.masked_fill(begun[:, None], 0.0)


def _remembered(told: Tensor, known: Tensor, memory: Tensor) -> Tensor:
    """Return the memory (N, U) of a gated recurrent unit after both its linear maps (N, 3U)."""
    (r, u, n), (reset, update, new) = told.chunk(3, dim=-1), known.chunk(3, dim=-1)
    fresh = torch.tanh(n + torch.sigmoid(r + reset) * new)
    return fresh + torch.sigmoid(u + update) * (memory - fresh)
