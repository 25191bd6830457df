"""The race as Gymnasium and Stable-Baselines3 environments."""

import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from stable_baselines3 import PPO
from stable_baselines3.common.env_checker import check_env as check_env_for_sb3

import racerl  # noqa: F401 (registers the environment)
from racerl.env.adapters.sb3 import RaceVecEnv
from racerl.errors import ConfigError
from tests.env.test_race import make, place

SMALL = ["budget=smoke"]


@pytest.mark.parametrize("overrides", [[], ["obs=progress", "action=speed", "+dr=all_0.1"]])
def test_check_env_is_clean(overrides):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        environment = gymnasium.make("racerl/Race-v0", overrides=overrides)
        check_env(environment.unwrapped)
        check_env_for_sb3(environment)


def test_the_vector_environment_keeps_last_observations():
    environment = gymnasium.make_vec("racerl/Race-v0", num_envs=4)
    observation, _ = environment.reset(seed=1)
    assert observation.shape == (4, 50) and environment.observation_space.contains(observation)
    place(environment.unwrapped.race, s=1.0, n=0.45, speed=3.0, heading=0.8)
    observation, reward, terminated, truncated, infos = environment.step(np.zeros((4, 2), np.float32))
    assert terminated.all() and not truncated.any() and (reward == -1).all()
    assert infos["_final_obs"].all() and not np.allclose(infos["final_obs"], observation)


def test_vector_seeds_are_one_for_all_or_one_for_each():
    environment = gymnasium.make_vec("racerl/Race-v0", num_envs=3)
    first, _ = environment.reset(seed=7)
    again, _ = environment.reset(seed=7)
    each, _ = environment.reset(seed=[1, 2, 1])
    assert np.array_equal(first, again)
    assert np.array_equal(each[0], each[2]) and not np.array_equal(each[0], each[1])
    assert np.array_equal(first, environment.reset(seed=np.int64(7))[0])
    assert np.array_equal(each, environment.reset(seed=np.array([1, 2, 1]))[0])
    apart, _ = environment.reset(seed=[None, None, 1])
    assert not np.array_equal(apart[0], apart[1]) and np.array_equal(apart[2], each[2])
    with pytest.raises(ConfigError, match="one seed is expected, or 3, one for each car"):
        environment.reset(seed=[1, 2])


def test_sb3_sees_the_end_of_episodes():
    race = make("sim.max_steps=2", cars=3)
    environment = RaceVecEnv(race)
    environment.reset()
    place(race, s=0.5)
    race.age[:] = 1
    observation, reward, done, infos = environment.step(np.zeros((3, 2), np.float32))
    assert done.all() and all(info["TimeLimit.truncated"] for info in infos)
    assert infos[0]["terminal_observation"].shape == observation[0].shape and (reward > 0).all()


def test_sb3_seeds_the_next_reset():
    environment = RaceVecEnv(make(cars=3))
    environment.seed(5)
    first = environment.reset()
    environment.seed(5)
    assert np.array_equal(first, environment.reset()) and not np.array_equal(first, environment.reset())


def test_a_plain_sb3_ppo_runs():
    model = PPO("MlpPolicy", RaceVecEnv(make(cars=8)), n_steps=16, batch_size=64, n_epochs=1, device="cpu")
    model.learn(256)
    assert model.num_timesteps == 256
