"""The race as a Stable-Baselines3 VecEnv (numpy in, numpy out)."""

from collections.abc import Iterable
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.vec_env import VecEnv

from racerl.env.adapters.spaces import action_space, observation_space
from racerl.env.race import Race
from racerl.env.races import Races


class RaceVecEnv(VecEnv):
    """N cars as N environments that start over by themselves."""

    def __init__(self, race: Race | Races) -> None:
        self.race = race
        self.render_mode = None
        super().__init__(race.count, observation_space(race), action_space())
        self._actions = torch.zeros(race.count, 2)

    def reset(self) -> np.ndarray:
        """Start all cars over; the generator is seeded anew when `seed` was called."""
        if self._seeds[0] is not None:
            self.race.reseed([self._seeds[0]])
        self._reset_seeds()
        return self.race.reset().cpu().numpy()

    def step_async(self, actions: np.ndarray) -> None:
        """Keep the actions (N, 2)."""
        self._actions = torch.as_tensor(actions, device=self.race.device)

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Drive one control step."""
        step = self.race.step(self._actions)
        done = (step.terminated | step.truncated).cpu().numpy()
        truncated, final = step.truncated.cpu().numpy(), step.final_observation.cpu().numpy()
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for i in np.flatnonzero(done):
            infos[i] = {"terminal_observation": final[i], "TimeLimit.truncated": bool(truncated[i])}
        return step.observation.cpu().numpy(), step.reward.cpu().numpy(), done, infos

    def close(self) -> None:
        """Nothing to close."""

    def get_attr(self, attr_name: str, indices: int | Iterable[int] | None = None) -> list[Any]:
        """Return an attribute of this adapter, once per car asked for."""
        return [getattr(self, attr_name)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: int | Iterable[int] | None = None) -> None:
        """Set an attribute of this adapter."""
        setattr(self, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: int | Iterable[int] | None = None, **method_kwargs: Any
    ) -> list[Any]:
        """Call a method of this adapter once, and return its result once per car asked for."""
        result = getattr(self, method_name)(*method_args, **method_kwargs)
        return [result] * len(list(self._get_indices(indices)))

    def env_is_wrapped(self, wrapper_class: type, indices: int | Iterable[int] | None = None) -> list[bool]:
        """Return False for every car."""
        return [False] * len(list(self._get_indices(indices)))
