"""PPO of a policy that remembers: rollouts carry its memory, and gradients go back through them in time.

A minibatch is whole rollouts of some cars, unrolled from the memory that each began with (truncated backpropagation
through time), and cut where an episode ends. The critic remembers nothing; with `privileged` it need not.
"""

import copy
from collections.abc import Callable, Iterator
from typing import Any

import torch
from torch import Tensor, nn

from racerl.control.networks import RecurrentNetwork, forgotten
from racerl.env.race import Race
from racerl.env.races import Races
from racerl.train.ppo import Budget, RacePPO
from racerl.train.rollout import Minibatch


class RecurrentPPO(RacePPO):
    """PPO whose actor has a gated recurrent unit."""

    _mean: RecurrentNetwork

    def __init__(self, race: Race | Races, budget: Budget, seed: int, units: int, **options: Any) -> None:
        self.units = units
        super().__init__(race, budget, seed, **options)
        self.memory = torch.zeros(race.count, units, device=race.device)
        self._first = self.memory  # at the beginning of the rollout
        self._begun = torch.zeros(budget.rollout, race.count, dtype=torch.bool, device=race.device)

    @property
    def carried(self) -> dict[str, Tensor]:
        """What the next rollout depends on beside the weights and the race."""
        return {"memory": self.memory}

    @carried.setter
    def carried(self, tensors: dict[str, Tensor]) -> None:
        self.memory = tensors["memory"].to(self.device)

    def _build_actor(self) -> RecurrentNetwork:
        network = RecurrentNetwork(self.race.observation.size, self.units, 2).to(self.race.device)
        self.policy.init_weights(network.gives[-1], 0.01)  # as Stable-Baselines3 draws the layer of the actions
        # in the policy, so that its weights are saved and clipped with the critic's; the feedforward actor is gone
        self.policy.recurrent = network
        self.policy.mlp_extractor.policy_net, self.policy.action_net = nn.Sequential(), nn.Identity()
        return network

    def actor(self) -> RecurrentNetwork:
        """Return a copy of the network of the mean action, for observations as the race gives them."""
        network = copy.deepcopy(self._mean)
        if self.budget.normalise:
            network.reads = self.normaliser.fold(network.reads)
        return network

    def _driver(self) -> Callable[[Tensor], Tensor]:
        actor, steps = self.actor(), iter(self._begun)
        self._first = self.memory

        def drive(observation: Tensor) -> Tensor:
            begun = next(steps).copy_(self.race.age == 0)
            mean, self.memory = actor(observation, forgotten(self.memory, begun))
            return mean

        return drive

    def _judge_actions(self) -> None:
        rollout = self.rollout
        means = self._mean.unroll(rollout.observations, self._begun, self._first)
        rollout.log_probs.copy_(self._log_prob(means, rollout.actions))

    def _minibatches(self) -> Iterator[tuple[Minibatch, Tensor]]:
        """Yield the rollouts of all cars once, in random order, each (T, B, …); a smaller remainder is left out."""
        rollout = self.rollout
        order = torch.randperm(rollout.cars, generator=self.shuffle).to(self.device)
        size = min(max(1, self.batch_size // rollout.steps), rollout.cars)
        for first in range(0, rollout.cars - size + 1, size):
            chosen = order[first : first + size]
            batch = Minibatch(*(table.index_select(1, chosen) for table in rollout.tables))
            begun, memory = self._begun.index_select(1, chosen), self._first.index_select(0, chosen)
            yield batch, self._mean.unroll(batch.observations, begun, memory)
