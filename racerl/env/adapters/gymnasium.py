"""The race as Gymnasium environments: one car, or a batch that starts over within the step."""

import secrets
from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from racerl.env.adapters.spaces import action_space, observation_space
from racerl.env.race import Race
from racerl.errors import ConfigError


class RaceEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """One car; the race must hold a single one."""

    metadata = {"render_modes": []}  # noqa: RUF012 (Gymnasium's own interface)

    def __init__(self, race: Race) -> None:
        self.race = race
        self.observation_space, self.action_space = observation_space(race), action_space()

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[np.ndarray, dict]:
        """Start over at a random place; a seed makes it a certain one."""
        super().reset(seed=seed)
        if seed is not None:
            self.race.reseed([seed])
        return self.race.reset()[0].cpu().numpy(), {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Drive one control step with an action (2,) in [−1, 1]."""
        step = self.race.step(torch.as_tensor(np.asarray(action), device=self.race.device)[None])
        observation = step.final_observation[0].cpu().numpy()
        info = {"progress": float(step.progress[0]), "margin": float(step.margin[0])}
        return observation, float(step.reward[0]), bool(step.terminated[0]), bool(step.truncated[0]), info


class RaceVectorEnv(VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """N cars; `infos["final_obs"]` holds the last observation of those that started over."""

    metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.SAME_STEP}  # noqa: RUF012

    def __init__(self, race: Race) -> None:
        self.race = race
        self.num_envs = race.count
        self.single_observation_space, self.single_action_space = observation_space(race), action_space()
        self.observation_space = batch_space(self.single_observation_space, race.count)
        self.action_space = batch_space(self.single_action_space, race.count)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start all cars over; one seed for all, or a list with one for each."""
        if seed is not None:
            self.race.reseed(self._seeds(seed))
        return self.race.reset().cpu().numpy(), {}

    def _seeds(self, given: int | Sequence[int | None]) -> list[int]:
        """Return one seed for all cars, or one for each; a car that is given none gets any."""
        seeds = np.asarray(given, dtype=object)
        each = np.atleast_1d(seeds).tolist()
        if seeds.ndim and len(each) != self.num_envs:
            raise ConfigError(f"seed = {each}: one seed is expected, or {self.num_envs}, one for each car")
        return [secrets.randbits(31) if seed is None else int(seed) for seed in each]

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Drive one control step with actions (N, 2) in [−1, 1]."""
        step = self.race.step(torch.as_tensor(np.asarray(actions), device=self.race.device))
        over = (step.terminated | step.truncated).cpu().numpy()
        infos: dict[str, Any] = {"progress": step.progress.cpu().numpy(), "margin": step.margin.cpu().numpy()}
        if over.any():
            infos |= {"final_obs": step.final_observation.cpu().numpy(), "_final_obs": over}
        return (
            step.observation.cpu().numpy(),
            step.reward.cpu().numpy(),
            step.terminated.cpu().numpy(),
            step.truncated.cpu().numpy(),
            infos,
        )
