"""The bonus for side slip: what a step pays, whom, and for how long."""

import math

import pytest
import torch
from stable_baselines3.common.logger import configure

from racerl.config import compose_settings
from racerl.env.race import V_X, V_Y
from racerl.errors import ConfigError
from racerl.evaluate.evaluate import learned
from racerl.train.algorithms import create_algorithm
from racerl.train.drift import Drift
from racerl.train.ppo import Budget, RacePPO
from tests.env.test_race import make
from tests.train.test_ppo import SMALL

DRIFT = Drift(bonus=5.0, best=0.7, fades=[0.2, 0.6])


def after_a_step(race, speeds):
    """Return a step after which the cars have these speeds, (v_x, v_y) each."""
    step = race.step(torch.zeros(race.count, 2))
    state = race.state.clone()
    state[V_X], state[V_Y] = torch.tensor(speeds).T
    race.state = state
    return step


def test_a_step_pays_the_slip_to_either_side_less_beyond_the_best_and_nothing_to_a_car_that_stands():
    race = make(cars=6)
    step = after_a_step(race, [(3.0, 1.5), (3.0, -1.5), (3.0, 3.0), (0.0, 5.0), (4.0, 0.0), (0.0, 0.0)])
    slip, beyond = math.atan(0.5), 1.4 - math.pi / 4
    weights = torch.tensor([slip, slip, beyond, 0.0, 0.0, 0.0])
    assert torch.allclose(DRIFT.pay(race, step, 0.0), 5.0 * 0.05 * weights, atol=1e-6)
    assert torch.allclose(DRIFT.pay(race, step, 0.4), 2.5 * 0.05 * weights, atol=1e-6)


def test_a_car_that_starts_over_is_paid_nothing():
    race = make(cars=3)
    step = after_a_step(race, [(3.0, 1.5)] * 3)
    ended = torch.tensor([False, True, False]), torch.tensor([False, False, True])
    paid = DRIFT.pay(race, step._replace(terminated=ended[0], truncated=ended[1]), 0.0)
    assert (paid > 0).tolist() == [True, False, False]


def test_the_bonus_is_whole_at_first_and_fades_to_none():
    assert [DRIFT.worth(done) for done in (0.0, 0.2, 0.4, 0.6, 1.0)] == pytest.approx([5.0, 5.0, 2.5, 0.0, 0.0])


def first_model(drift, begun=0):
    """Return a learner that has driven one rollout after so many control steps: the same actions whatever is paid."""
    model = RacePPO(make(cars=32), Budget.of({**SMALL, "cars": 32}), 0, drift=drift)
    model.set_logger(configure(None, []))
    _, callback = model._setup_learn(SMALL["steps"])
    model.num_timesteps = begun
    torch.manual_seed(0)
    model.collect_rollouts(model.env, callback, model.rollout_buffer, model.n_steps)
    return model


@pytest.mark.parametrize(("begun", "paid"), [(0, True), (SMALL["steps"], False)])
def test_ppo_learns_from_it_until_it_has_faded(begun, paid):
    rewards = [first_model(drift, begun).rollout.rewards for drift in (None, DRIFT)]
    more = rewards[1] - rewards[0]
    assert bool((more >= 0).all()) and bool((more > 0.01).any()) is paid and bool((more == 0).all()) is not paid


def test_what_is_told_as_reward_is_the_races():
    told = [first_model(drift).reward for drift in (None, DRIFT)]
    assert told[0] == pytest.approx(told[1], abs=1e-6)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"fades": [0.6, 0.2]}, "the first is to be less than the second"),
        ({"fades": 0.6}, "two shares of the training"),
        ({"fades": [0.2, 1.6]}, "algo.drift.fades = 1.6"),
        ({"bonus": -1.0}, "algo.drift.bonus = -1.0"),
        ({"bonuses": 1.0}, "bonuses"),
    ],
)
def test_wrong_numbers_are_refused_before_anything_is_trained(wrong, words):
    algo = compose_settings("train", ["algo=ppo_drift"])["algo"]
    with pytest.raises(ConfigError, match=words):
        create_algorithm({**algo, "drift": {**algo["drift"], **wrong}})


def test_tables_say_that_a_policy_drifted_first():
    assert learned(compose_settings("train", ["algo=ppo_drift"])) == "PPO drifting first refined"
    assert learned(compose_settings("train", ["budget=unrefined"])) == "PPO"
