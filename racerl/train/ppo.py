"""Proximal policy optimisation on the batched race: Stable-Baselines3's PPO with rollout and update on tensors.

Networks, schedules, callbacks and logger are Stable-Baselines3's. Overridden are collecting rollouts (no per-car
Python) and the update (measures stay on the device, but for the one that lets the actor rest). Optional, and what makes
the laptop budget fast: observations normalised by their running moments, a learning rate of the actor that follows the
KL divergence of its updates while the critic keeps learning, and action noise that falls on a schedule.
"""

import copy
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

import torch
from stable_baselines3 import PPO
from stable_baselines3.common.buffers import RolloutBuffer
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv
from torch import Tensor, nn

from racerl import bounds
from racerl.control.networks import SLOPE
from racerl.control.policy import IMPROVEMENTS, AnyPolicy
from racerl.env.adapters.sb3 import RaceVecEnv
from racerl.env.race import Race
from racerl.env.races import Races
from racerl.registry import construct
from racerl.train.drift import Drift
from racerl.train.normaliser import Normaliser, moments
from racerl.train.products import fast_products
from racerl.train.rollout import Minibatch, Rollout
from racerl.train.session import policy_of

# least and greatest of each
WHOLE = {
    "steps": (1, 10**12),
    "evaluations": (1, 10**6),
    "cars": (1, 10**6),
    "rollout": (1, 10**6),
    "epochs": (1, 10**4),
    "batch": (2, 10**9),  # advantages are taken relative to their deviation
}
RANGES = {
    "gamma": (0.0, 1.0),
    "gae_lambda": (0.0, 1.0),
    "learning_rate": (1e-9, 1.0),
    "final_learning_rate": (1e-9, 1.0),
    "adam_epsilon": (1e-12, 1.0),
    "clip": (1e-3, 10.0),
    "entropy": (0.0, 10.0),
    "value": (1e-6, 1e6),
    "gradient_norm": (1e-6, 1e9),
    "target_kl": (1e-9, 1e3),
    "kl_step": (1.0, 100.0),
    "kl_largest": (1.0, 1e3),
    "lowest_rate": (1e-9, 1.0),
    "initial_std": (1e-4, 10.0),
    "final_std": (1e-4, 10.0),
}
OPTIONAL = ("target_kl", "final_std")  # or null
JUDGED_AT_ONCE = 16_384  # observations, so that the layers' outputs stay small


@dataclass(frozen=True)
class Budget:
    """How long and how to train; `conf/budget/*.yaml` says what each number is, and gives all of them."""

    trial: bool
    steps: int
    evaluations: int
    cars: int
    rollout: int
    gamma: float
    gae_lambda: float
    epochs: int
    batch: int
    learning_rate: float
    final_learning_rate: float
    adam_epsilon: float
    clip: float
    entropy: float
    value: float
    gradient_norm: float
    target_kl: float | None
    kl_step: float
    kl_largest: float
    lowest_rate: float
    initial_std: float
    final_std: float | None
    actor: Sequence[int]
    critic: Sequence[int]
    normalise: bool
    bf16: bool

    @classmethod
    def of(cls, settings: Mapping[str, Any]) -> "Budget":
        """Build the budget of `conf/budget/*.yaml`, in which what follows is not PPO's."""
        own = {key: value for key, value in settings.items() if key not in IMPROVEMENTS}
        budget: Budget = construct(cls, own, "budget")
        return budget

    def __post_init__(self) -> None:
        for name, (least, most) in WHOLE.items():
            given = getattr(self, name)
            whole = int(given) if isinstance(given, float) and given.is_integer() else given  # 1e6 is one
            object.__setattr__(self, name, bounds.whole(f"budget.{name}", whole, least, most))
        for name, (low, high) in RANGES.items():
            optional = name in OPTIONAL
            if not (optional and getattr(self, name) is None):
                bounds.number(f"budget.{name}", getattr(self, name), low, high, "or null" if optional else "")
        for name in ("actor", "critic"):
            bounds.layers(f"budget.{name}", getattr(self, name))
        for name in ("trial", "normalise", "bf16"):
            bounds.switch(f"budget.{name}", getattr(self, name))


def hyperparameters(budget: Budget) -> dict[str, Any]:
    """Return a budget as arguments of Stable-Baselines3's PPO; its batch size and `target_kl` are left out."""
    first, last = budget.learning_rate, budget.final_learning_rate
    return {
        "policy": "MlpPolicy",
        "learning_rate": lambda remaining: last + (first - last) * max(remaining, 0.0),  # the last rollout may end late
        "n_steps": budget.rollout,
        "n_epochs": budget.epochs,
        "gamma": budget.gamma,
        "gae_lambda": budget.gae_lambda,
        "clip_range": budget.clip,
        "ent_coef": budget.entropy,
        "vf_coef": budget.value,
        "max_grad_norm": budget.gradient_norm,
        "policy_kwargs": {
            "net_arch": {"pi": list(budget.actor), "vf": list(budget.critic)},
            "activation_fn": _LeakyReLU,
            "log_std_init": math.log(budget.initial_std),
        },
    }


class RacePPO(PPO):
    """PPO whose rollouts stay tensors from the simulator to the update.

    With `privileged` the critic is told each car's drawn parameters, which the policy has to do without; with `drift`
    cars are paid for side slip at first.
    """

    def __init__(
        self, race: Race | Races, budget: Budget, seed: int, privileged: bool = False, drift: Drift | None = None
    ) -> None:
        self.race = race
        self.budget = budget
        self.privileged = privileged
        self.drift = drift
        self.shuffle = torch.Generator().manual_seed(seed)
        super().__init__(
            env=RaceVecEnv(race),
            batch_size=race.count * budget.rollout,  # of its own buffer, which stays unused
            rollout_buffer_class=_NoBuffer,
            seed=seed,
            device=race.device,
            **hyperparameters(budget),
        )
        self.batch_size = budget.batch
        more = self._privileged().shape[1]
        self.rollout = Rollout(budget.rollout, race.count, race.observation.size, 2, race.device, more)
        self.bonus = torch.zeros((), device=race.device)  # mean of what was paid for drifting in a step of it
        self.rate_factor = 1.0  # of the actor's scheduled learning rate, when it follows the KL divergence
        self.normaliser = Normaliser(race.observation.size, race.device)
        self._mean = self._build_actor()
        if more:
            layers = self.policy.mlp_extractor.value_net
            first = cast(nn.Linear, layers[0])
            layers[0] = nn.Linear(first.in_features + more, first.out_features, device=race.device)
            self.policy.init_weights(layers[0], math.sqrt(2.0))  # as Stable-Baselines3 draws hidden layers
        self._value = nn.Sequential(*self.policy.mlp_extractor.value_net, self.policy.value_net)
        actor, critic = [*self._mean.parameters(), self.policy.log_std], [*self._value.parameters()]
        groups: list[dict[str, Any]] = [{"params": actor}, {"params": critic}]
        self.policy.optimizer = torch.optim.Adam(groups, eps=budget.adam_epsilon, fused=True)
        self.policy.log_std.requires_grad_(budget.final_std is None)

    def _maybe_recommend_cpu(self, mlp_class_name: str = "") -> None:
        """Say nothing: with the simulator on the GPU too, small networks are as much at home there."""

    @property
    def carried(self) -> dict[str, Tensor]:
        """What the next rollout depends on beside weights, moments and race, by name."""
        return {}

    @carried.setter
    def carried(self, tensors: dict[str, Tensor]) -> None:
        """Nothing is carried."""

    def _build_actor(self) -> nn.Module:
        return actor_of(self)

    def actor(self) -> nn.Module:
        """Return the network of the mean action for observations as the race gives them."""
        network = cast(nn.Sequential, self._mean)
        return self.normaliser.fold(network) if self.budget.normalise else network

    def as_policy(self, settings: Mapping[str, Any]) -> AnyPolicy:
        """Return a copy of the actor as a policy for the race it learns in."""
        return policy_of(copy.deepcopy(self.actor()), self.race, settings)

    @property
    def reward(self) -> float:
        """Mean reward of the race in a step of the last rollout, without what is paid for drifting."""
        return float(self.rollout.rewards.mean() - self.bonus)

    def _driver(self) -> Callable[[Tensor], Tensor]:
        """Return what gives the mean actions of one rollout, step by step."""
        return self.actor()

    def collect_rollouts(
        self, env: VecEnv, callback: BaseCallback, rollout_buffer: RolloutBuffer, n_rollout_steps: int
    ) -> bool:
        """Drive all cars for one rollout with the current stochastic policy."""
        callback.on_rollout_start()
        self.policy.set_training_mode(False)
        self._set_noise()
        observation, rollout, drive = self.race.observe(), self.rollout, self._driver()
        privileged = self._privileged()
        with torch.no_grad():
            self.bonus = torch.zeros_like(self.bonus)
            noise = self.policy.log_std.exp() * torch.randn_like(rollout.actions)
            for t in range(n_rollout_steps):
                action = drive(observation) + noise[t]
                step = self.race.step(action)
                rollout.observations[t], rollout.actions[t], rollout.privileged[t] = observation, action, privileged
                rollout.rewards[t] = step.reward
                if self.drift is not None:
                    paid = self.drift.pay(self.race, step, self.num_timesteps / self.budget.steps)
                    rollout.rewards[t] += paid
                    self.bonus += paid.mean() / n_rollout_steps
                rollout.cut_off[t] = self._time_out_value(step.truncated, step.final_observation, privileged)
                rollout.ended[t] = step.terminated | step.truncated
                observation, privileged = step.observation, self._privileged()
                self.num_timesteps += self.race.count
                if not callback.on_step():
                    return False
            self._moments = moments(rollout.observations)
            rollout.observations.copy_(self._seen(rollout.observations))
            self._judge()
            rollout.estimate(self._values(observation, privileged), self.gamma, self.gae_lambda)
        callback.on_rollout_end()
        return True

    def _judge(self) -> None:
        """Fill in values and action densities of a rollout whose observations are as the networks see them."""
        rollout = self.rollout
        with fast_products(self.device, self.budget.bf16):
            for seen, privileged, values in self._in_parts(rollout.observations, rollout.privileged, rollout.values):
                values.copy_(self._judged(seen, privileged))
            self._judge_actions()

    def _judge_actions(self) -> None:
        """Fill in the action densities of a rollout."""
        rollout = self.rollout
        for seen, actions, log_probs in self._in_parts(rollout.observations, rollout.actions, rollout.log_probs):
            log_probs.copy_(self._log_prob(self._mean(seen), actions))

    def _in_parts(self, *tables: Tensor) -> Iterator[tuple[Tensor, ...]]:
        """Yield some steps of a rollout's tables (T, N, …) after others."""
        steps = max(1, JUDGED_AT_ONCE // self.rollout.cars)
        return zip(*(table.split(steps) for table in tables), strict=True)

    def _time_out_value(self, truncated: Tensor, final: Tensor, privileged: Tensor) -> Tensor:
        """Return γ·V of the final observation where an episode was cut off, else 0; shape (N,)."""
        if self.race.waits and not bool(truncated.any()):
            return torch.zeros_like(truncated, dtype=final.dtype)
        return self.gamma * self._values(final, privileged) * truncated

    def _seen(self, observations: Tensor) -> Tensor:
        """Return what the networks are shown."""
        return self.normaliser(observations) if self.budget.normalise else observations

    def _privileged(self) -> Tensor:
        """Return what the critic alone is told (N, K)."""
        return self.race.privileged() if self.privileged else torch.empty(self.race.count, 0, device=self.race.device)

    def _values(self, observations: Tensor, privileged: Tensor) -> Tensor:
        """Return the critic's values (N,) of observations as the race gives them."""
        return self._judged(self._seen(observations), privileged)

    def _judged(self, seen: Tensor, privileged: Tensor) -> Tensor:
        """Return the critic's values (…) of what the networks see (…, O) and what it alone is told (…, K)."""
        values: Tensor = self._value(torch.cat([seen, privileged], dim=-1) if privileged.shape[-1] else seen)
        return values.squeeze(-1)

    def _log_prob(self, mean: Tensor, actions: Tensor) -> Tensor:
        """Return the log density (…) of actions (…, 2), normally distributed around their mean."""
        log_std = self.policy.log_std
        return -(0.5 * ((actions - mean) * (-log_std).exp()) ** 2 + log_std + 0.5 * math.log(2 * math.pi)).sum(dim=-1)

    def _set_noise(self) -> None:
        """Put the action noise where the schedule wants it."""
        last = self.budget.final_std
        if last is not None:
            remaining = max(self._current_progress_remaining, 0.0)
            noise = remaining * math.log(self.budget.initial_std) + (1.0 - remaining) * math.log(last)
            with torch.no_grad():
                self.policy.log_std.fill_(noise)

    def train(self) -> None:
        """Update actor and critic from the rollout."""
        self.policy.set_training_mode(True)
        self._update_learning_rate(self.policy.optimizer)
        actor, critic = self.policy.optimizer.param_groups
        scheduled = critic["lr"]
        actor["lr"] = scheduled * self.rate_factor
        sums: dict[str, Tensor] = {}
        count, resting = 0, False
        with fast_products(self.device, self.budget.bf16):
            for _ in range(self.n_epochs):
                for batch, means in self._minibatches():
                    measures, resting = self._update(batch, means, resting)
                    count += 1
                    for name, value in measures.items():
                        sums[name] = sums.get(name, torch.zeros_like(value)) + value
        self._follow_divergence(resting, float(measures["approx_kl"]))
        self._n_updates += self.n_epochs
        self.normaliser.update(*self._moments)
        for name, value in sums.items():
            self.logger.record(f"train/{name}", float(value) / count)
        residual = (self.rollout.returns - self.rollout.values).var()
        self.logger.record("train/explained_variance", 1.0 - float(residual / self.rollout.returns.var()))
        self.logger.record("train/std", float(self.policy.log_std.detach().exp().mean()))
        self.logger.record("train/learning_rate", scheduled * self.rate_factor)
        self.logger.record("train/reward", self.reward)

    def _minibatches(self) -> Iterator[tuple[Minibatch, Tensor]]:
        """Yield all samples of the rollout once, in random order, with the mean actions as they are by then."""
        for batch in self.rollout.minibatches(self.batch_size, self.shuffle):
            yield batch, self._mean(batch.observations)

    def _update(self, batch: Minibatch, means: Tensor, resting: bool) -> tuple[dict[str, Tensor], bool]:
        """Take one gradient step, of the critic alone while the actor rests.

        Return its measures, as tensors so that nothing waits for them, and whether the actor now rests.
        """
        log_prob = self._log_prob(means, batch.actions)
        log_ratio = log_prob - batch.log_probs
        ratio = log_ratio.exp()
        divergence = (ratio - 1 - log_ratio).mean().detach()
        resting = resting or self._too_far(divergence)
        advantages = (batch.advantages - batch.advantages.mean()) / (batch.advantages.std() + 1e-8)
        clip = self.budget.clip
        policy_loss = -torch.minimum(advantages * ratio, advantages * ratio.clamp(1 - clip, 1 + clip)).mean()
        value_loss = nn.functional.mse_loss(self._judged(batch.observations, batch.privileged).float(), batch.returns)
        loss = self.vf_coef * value_loss
        if not resting:
            entropy = (self.policy.log_std + 0.5 * math.log(2 * math.pi * math.e)).sum()
            loss = loss + policy_loss - self.ent_coef * entropy
        self.policy.optimizer.zero_grad()  # to None: the optimizer passes over what has no gradient
        loss.backward()
        nn.utils.clip_grad_norm_(self.policy.parameters(), self.max_grad_norm)
        self.policy.optimizer.step()
        return {
            "policy_loss": policy_loss.detach(),
            "value_loss": value_loss.detach(),
            "approx_kl": divergence,
            "clip_fraction": ((ratio - 1).abs() > clip).float().mean(),
        }, resting

    def _too_far(self, divergence: Tensor) -> bool:
        """Return whether the actor has gone too far from the one that drove; never without a target."""
        target = self.budget.target_kl
        return target is not None and bool(divergence > self.budget.kl_largest * target)

    def _follow_divergence(self, rested: bool, divergence: float) -> None:
        """Lower the actor's learning rate after a rollout whose updates went too far, raise it after timid ones."""
        target = self.budget.target_kl
        if target is None:
            return
        if rested:
            self.rate_factor /= self.budget.kl_step
        elif divergence < target:
            self.rate_factor *= self.budget.kl_step
        self.rate_factor = min(max(self.rate_factor, self.budget.lowest_rate), 1.0)


def actor_of(model: PPO) -> nn.Sequential:
    """Return the mean action's network of any of Stable-Baselines3's PPO policies, sharing its weights."""
    return nn.Sequential(*model.policy.mlp_extractor.policy_net, model.policy.action_net)


class _LeakyReLU(nn.LeakyReLU):
    """LeakyReLU of the policies' slope, as a class that Stable-Baselines3 can call without arguments."""

    def __init__(self) -> None:
        super().__init__(SLOPE)


class _NoBuffer(RolloutBuffer):
    """Stands in for the numpy buffer that Stable-Baselines3 would allocate."""

    def __init__(self, buffer_size: int, *args: Any, **kwargs: Any) -> None:
        super().__init__(1, *args, **kwargs)
