"""A rollout as preallocated tensors (T, N, …), with generalised advantage estimation."""

from collections.abc import Iterator
from typing import NamedTuple

import torch
from torch import Tensor


class Minibatch(NamedTuple):
    """Samples for one gradient step, each (B, …); whole rollouts of B cars, (T, B, …), where a policy remembers."""

    observations: Tensor
    actions: Tensor
    log_probs: Tensor
    advantages: Tensor
    returns: Tensor
    privileged: Tensor


class Rollout:
    """T steps of N cars."""

    def __init__(
        self, steps: int, cars: int, observation_size: int, action_size: int, device: torch.device, privileged: int = 0
    ) -> None:
        def table(*shape: int) -> Tensor:
            return torch.zeros(steps, cars, *shape, device=device)

        self.steps, self.cars = steps, cars
        self.observations, self.actions = table(observation_size), table(action_size)
        self.privileged = table(privileged)  # numbers for the critic alone
        self.rewards, self.values, self.log_probs, self.ended = table(), table(), table(), table()
        self.cut_off = table()  # γ·V of the final observation where an episode was cut off, else 0
        self.advantages, self.returns = table(), table()

    def estimate(self, last_value: Tensor, gamma: float, gae_lambda: float) -> None:
        """Fill advantages and returns, given the value (N,) after the last step.

        A_t = δ_t + γλ c_t A_{t+1},  δ_t = r_t + b_t + γ c_t V_{t+1} − V_t,  c_t = 0 where an episode ended, else 1,
        with b_t what was still to come where it was only cut off. Rewards stay as they are.
        """
        continues = 1.0 - self.ended
        ahead = torch.cat([self.values[1:], last_value[None]])
        deltas = self.rewards + self.cut_off + gamma * continues * ahead - self.values
        decays = gamma * gae_lambda * continues
        advantage = torch.zeros_like(last_value)
        for t in reversed(range(self.steps)):
            advantage = torch.addcmul(deltas[t], decays[t], advantage)
            self.advantages[t] = advantage
        self.returns = self.advantages + self.values

    @property
    def tables(self) -> tuple[Tensor, ...]:
        """What is learned from (T, N, …), in the order of `Minibatch`."""
        return self.observations, self.actions, self.log_probs, self.advantages, self.returns, self.privileged

    def minibatches(self, size: int, generator: torch.Generator) -> Iterator[Minibatch]:
        """Yield all samples once, in random order, in minibatches; a smaller remainder is left out."""
        flat = [table.flatten(0, 1) for table in self.tables]
        total = self.steps * self.cars
        order = torch.randperm(total, generator=generator, device=generator.device).to(self.rewards.device)
        size = min(size, total)
        for first in range(0, total - size + 1, size):
            chosen = order[first : first + size]
            yield Minibatch(*(table.index_select(0, chosen) for table in flat))
