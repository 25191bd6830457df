"""A policy that remembers: its arithmetic, its files, and a task that nothing without a memory can learn."""

import json

import pytest
import torch
from stable_baselines3.common.logger import configure
from torch.nn.functional import linear

from racerl.config import compose_settings
from racerl.control.networks import RecurrentNetwork, build_network, forgotten, maps, walk
from racerl.control.policy import FACTS, Policy, RecurrentPolicy, load_policy, save_policy
from racerl.errors import ConfigError, PolicyError
from racerl.evaluate.evaluate import evaluate, learned
from racerl.train.onward import train_onward
from racerl.train.ppo import Budget, RacePPO
from racerl.train.recurrent_ppo import RecurrentPPO
from racerl.train.train import train
from tests.env.test_race import make
from tests.train.short import ascent, refinement
from tests.train.test_ppo import SMALL

UNITS = 16


def learner(race=None, **changes):
    budget = Budget.of({**SMALL, "normalise": True, **changes})
    model = RecurrentPPO(race or make(cars=budget.cars), budget, 0, units=UNITS)
    model.set_logger(configure(None, []))
    return model


def test_unrolled_it_gives_what_it_gives_step_by_step():
    torch.manual_seed(0)
    network, observations, memory = RecurrentNetwork(6, 8, 2), torch.randn(12, 5, 6), torch.randn(5, 8)
    begun = torch.rand(12, 5) < 0.2
    assert begun.any()
    means, at = network.unroll(observations, begun, memory), memory
    for observation, new, mean in zip(observations, begun, means, strict=True):
        at = torch.where(new[:, None], torch.zeros(8), at)
        action, at = network(observation, at)
        assert torch.allclose(action, mean, atol=1e-6)


def test_what_it_learns_from_is_what_it_drove_by():
    """Over episodes that end inside rollouts, and from the memory that the rollout before left."""
    model = learner(make("sim.max_steps=11", cars=64))
    driven, build = [], model._driver

    def noted():
        drive = build()
        driven.clear()
        return lambda observation: driven.append(drive(observation)) or driven[-1]

    model._driver = noted  # type: ignore[method-assign]
    model.learn(3 * 64 * 32 - 1)
    assert model._first.abs().max() > 0.01 and 0 < model._begun.float().mean() < 0.2
    model.collect_rollouts(model.env, model._init_callback(None), model.rollout_buffer, model.n_steps)
    kept = torch.stack(driven)
    for batch, means in model._minibatches():
        # judged by products that may be of bf16
        assert torch.allclose(model._log_prob(means, batch.actions), batch.log_probs, atol=5e-3)
    unrolled = model._mean.unroll(model.rollout.observations, model._begun, model._first)
    assert torch.allclose(unrolled, kept, atol=1e-4)


def asked_for_what_was(race):
    """Return a race that pays for the sign that its cars were shown a step ago, in place of their first number."""
    honest, dice = race.step, torch.Generator().manual_seed(0)
    signs = torch.zeros(2, race.count)  # now, and before

    def marked(observation):
        return torch.cat([signs[0][:, None], observation[:, 1:]], dim=1)

    def step(action):
        taken = honest(0.0 * action)
        paid = -((action[:, 0] - signs[1]) ** 2)
        signs[1], signs[0] = signs[0].clone(), torch.randint(0, 2, (race.count,), generator=dice) * 2.0 - 1.0
        return taken._replace(reward=paid, observation=marked(taken.observation))

    race.step = step
    return race


def test_it_learns_what_asks_for_a_memory_and_a_feedforward_policy_does_not():
    budget = {"gamma": 0.1, "epochs": 4, "learning_rate": 5e-3, "final_std": 0.1, "normalise": True}
    remembers = learner(asked_for_what_was(make(cars=64)), **budget)
    forgets = RacePPO(asked_for_what_was(make(cars=64)), Budget.of({**SMALL, **budget}), 0)
    forgets.set_logger(configure(None, []))
    rewards = {}
    for name, model in {"remembers": remembers, "forgets": forgets}.items():
        model.learn(20_000)
        rewards[name] = float(model.rollout.rewards.mean())
    # the sign before is ± 1, unknown to who is shown the present one: 1 + noise
    assert rewards["remembers"] > -0.3 and rewards["forgets"] < -0.9


@pytest.fixture
def policy():
    torch.manual_seed(0)
    race = make(cars=4)
    return RecurrentPolicy(RecurrentNetwork(race.observation.size, UNITS, 2), {"name": "geometric"}, {"name": "speed"})


def test_it_comes_back_as_it_was_and_remembers_from_where_an_episode_begins(policy, tmp_path):
    save_policy(policy, tmp_path)
    again, race = load_policy(tmp_path), make(cars=4)
    memory = torch.zeros(4, UNITS)
    for step in range(6):
        if step == 3:
            race.reset()
        action, memory = policy.network(race.observe(), forgotten(memory, torch.full((4,), step in (0, 3))))
        given = again.act(race)
        assert torch.equal(given, action.detach().clamp(-1, 1)), step
        race.step(given)
    assert again.act(other := make(cars=2)).shape == (2, 2) and other.count == 2  # another race, other cars


def test_a_policy_without_a_memory_is_read_as_before(tmp_path):
    save_policy(Policy(build_network([6, 8, 2]), {"name": "geometric"}, {"name": "speed"}), tmp_path)
    assert isinstance(load_policy(tmp_path), Policy) and "recurrent" not in json.loads((tmp_path / FACTS).read_text())


@pytest.mark.parametrize("layers", [[50, 16], [50, 16, 16, 2], [50, 0, 2], [50, 17, 2]])
def test_wrong_sizes_are_refused(policy, tmp_path, layers):
    save_policy(policy, tmp_path)
    (tmp_path / FACTS).write_text(json.dumps({**json.loads((tmp_path / FACTS).read_text()), "layers": layers}))
    with pytest.raises(PolicyError, match=r"3 … 3 positive sizes|does not fit"):
        load_policy(tmp_path)


def settings(*words):
    return compose_settings("train", ["algo=ppo_recurrent", "budget=smoke", "threads=1", *words])


def test_a_trained_one_is_refined_races_and_is_named(tmp_path):
    asked = settings(refinement())
    facts = train(asked, tmp_path / "run")
    assert learned(asked) == "recurrent PPO refined by evolution" and facts["refined"] == 2
    before, after = (load_policy(tmp_path / run).network.state_dict() for run in ("run/unrefined", "run"))
    assert before.keys() == after.keys()
    words = [f"run={tmp_path / 'run'}", "laps=1", "seeds=[0]", "threads=1"]
    assert evaluate(compose_settings("evaluate", words), tmp_path / "laps")["laps"] == 1
    for ending, steps in ((refinement(), {"refined": 2}), (ascent(), {"ascended": 4})):
        onward = compose_settings("refine", [f"from={tmp_path / 'run'}", "budget=smoke", "threads=1", ending])
        assert steps.items() <= train_onward(onward, tmp_path / next(iter(steps))).items()


def test_walked_it_gives_what_it_gives_itself():
    torch.manual_seed(0)
    for network in (RecurrentNetwork(6, 8, 2), build_network([6, 8, 8, 2])):
        own, observation = maps(network), torch.randn(5, 6)
        memory = torch.randn(5, 8 if isinstance(network, RecurrentNetwork) else 0)
        walked, remembered = walk(network, observation, memory, lambda i, x, own=own: linear(x, *own[i]))
        if isinstance(network, RecurrentNetwork):
            action, after = network(observation, memory)
            torch.testing.assert_close(remembered, after)
        else:
            action = network(observation)
        torch.testing.assert_close(walked, action)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["algo.recurrent.units=0"], "algo.recurrent.units = 0"),
        (["+algo.recurrent.unit=3"], "no setting .unit."),
    ],
)
def test_what_cannot_be_is_refused_before_anything_is_trained(words, said, tmp_path):
    with pytest.raises(ConfigError, match=said) as error:
        train(settings(*words), tmp_path / "run")
    assert "\n" not in str(error.value) and not (tmp_path / "run").exists()
