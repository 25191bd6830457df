"""A policy that remembers: a gated recurrent unit between observation and action, kept in the files of any policy.

z = LeakyReLU(W o + b), h' = GRU(z, h), action = a feedforward network of (z, h'); h is nought where an episode begins.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor, nn

from racerl.control.policy import RECURRENT, SLOPE, Policy, build_network, fill, load_policy, read_facts

if TYPE_CHECKING:
    from racerl.env.race import Race


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


class RecurrentPolicy:
    """The mean action of a trained actor that remembers; one race at a time, from its first step on."""

    name = "policy"

    def __init__(self, network: RecurrentNetwork, observation: Mapping[str, Any], action: Mapping[str, Any]) -> None:
        self.network, self.observation, self.action = network, observation, action
        self._memory = torch.empty(0, self.units)

    @property
    def sizes(self) -> list[int]:
        """Numbers that it reads, remembers and gives."""
        return self.network.sizes

    @property
    def units(self) -> int:
        """Numbers that it remembers from step to step."""
        return self.sizes[1]

    @torch.no_grad()
    def decide(self, observation: Tensor, memory: Tensor) -> tuple[Tensor, Tensor]:
        """Return actions (N, 2) in [−1, 1] and the memory (N, U) after them."""
        actions, memory = self.network(observation, memory)
        return actions.clamp(-1.0, 1.0), memory

    def act(self, race: "Race") -> Tensor:
        """Return the actions for the cars of a race; of those whose episode begins, nothing is remembered."""
        if len(self._memory) != race.count:
            self._memory = torch.zeros(race.count, self.units, device=race.device)
        actions, self._memory = self.decide(race.observe(), forgotten(self._memory, race.age == 0))
        return actions


def forgotten(memory: Tensor, begun: Tensor) -> Tensor:
    """Return a memory (N, U) that is nought for the cars whose episode begins (N,)."""
    return memory.masked_fill(begun[:, None], 0.0)


def load_driver(folder: Path, device: torch.device | str = "cpu") -> Policy | RecurrentPolicy:
    """Read a policy that remembers or one that does not; raise PolicyError as `load_policy` does."""
    facts = read_facts(folder)
    if not facts.get(RECURRENT):
        return load_policy(folder, device)
    network = RecurrentNetwork(*facts["layers"]).to(device)
    fill(network, folder)
    return RecurrentPolicy(network, facts["observation"], facts["action"])
