"""Learning: advantages against an independent formula, a policy that must improve, and one that cannot."""

import dataclasses

import numpy as np
import pytest
import torch
from stable_baselines3.common.buffers import RolloutBuffer
from stable_baselines3.common.logger import configure

from racerl.config import compose_settings
from racerl.errors import ConfigError
from racerl.train.ppo import Budget, RacePPO, actor_of
from racerl.train.products import has_bf16
from racerl.train.rollout import Rollout
from tests.conftest import CONF
from tests.env.test_race import make

SWITCHES = ("trial", "normalise", "bf16")

SMALL = {
    **compose_settings("train", ["budget=smoke"])["budget"],
    "cars": 64,
    "rollout": 32,
    "batch": 512,
    "epochs": 5,
    "learning_rate": 1e-3,
    "final_learning_rate": 1e-3,
    "actor": [32, 32],
    "critic": [32, 32],
    "steps": 60_000,
    "gamma": 0.95,
    "initial_std": 0.5,
}


def learner(race=None, seed=0, privileged=False, **changes):
    budget = Budget.of({**SMALL, **changes})
    model = RacePPO(race or make(cars=budget.cars), budget, seed, privileged)
    model.set_logger(configure(None, []))
    return model


def test_advantages_are_those_of_stable_baselines3():
    steps, cars = 20, 7
    model = learner(make(cars=cars), cars=cars)
    buffer = RolloutBuffer(steps, model.observation_space, model.action_space, "cpu", 0.9, 0.97, cars)
    rollout = Rollout(steps, cars, 50, 2, torch.device("cpu"))
    draw = np.random.default_rng(0)
    rewards, values = draw.normal(size=(2, steps, cars)).astype(np.float32)
    done = draw.random((steps + 1, cars)) < 0.2
    to_come = (draw.random((steps, cars)) * done[1:]).astype(np.float32)  # where episodes were cut off
    buffer.rewards, buffer.values, buffer.episode_starts = rewards + to_come, values, done[:-1].astype(np.float32)
    last = draw.normal(size=cars).astype(np.float32)
    buffer.compute_returns_and_advantage(torch.tensor(last), done[-1])
    rollout.rewards[:], rollout.values[:] = torch.tensor(rewards), torch.tensor(values)
    rollout.ended[:], rollout.cut_off[:] = torch.tensor(done[1:]).float(), torch.tensor(to_come)
    rollout.estimate(torch.tensor(last), gamma=0.97, gae_lambda=0.9)
    assert np.allclose(rollout.advantages.numpy(), buffer.advantages, atol=1e-5)
    assert np.allclose(rollout.returns.numpy(), buffer.returns, atol=1e-5)


def test_a_time_out_is_bootstrapped_and_an_end_is_not():
    model = learner(make("sim.max_steps=60", cars=64), rollout=128, initial_std=2.0)
    model.learn(64 * 128)
    rollout = model.rollout
    cut = rollout.ended == 1
    assert cut.any()
    # a car that was cut off got its progress plus γV; one that left the track got −1
    left = cut & (rollout.rewards == -1.0)
    timed_out = cut & ~left
    assert left.any() and timed_out.any()
    final = model.policy.predict_values(torch.zeros(1, 50)).detach()
    assert torch.isfinite(final).all()
    model.policy.value_net.bias.data += 100.0
    truncated = torch.tensor([True, False, True])
    added = model._time_out_value(truncated, torch.zeros(3, 50), torch.zeros(3, 0)).detach()
    assert float(added[0]) == pytest.approx(0.95 * (float(final) + 100.0), rel=1e-5) and float(added[1]) == 0.0


def test_a_privileged_critic_knows_the_cars_apart_and_the_policy_does_not():
    """The reward is the car's friction here, which no observation shows: only who is told can foretell it."""
    spread = ["dr=all_0.1", "dr.parameters=[friction]", "sim.max_steps=40"]
    foretold = {}
    for privileged in (False, True):
        model = learner(make(*spread, cars=64), privileged=privileged, gamma=0.5, learning_rate=3e-3)
        honest = model.race.step

        def step(action, race=model.race, honest=honest):
            told = race.privileged()[:, 0].clone()
            return honest(action)._replace(reward=told)

        model.race.step = step  # type: ignore[method-assign]
        model.learn(60_000)
        assert model.actor()[0].in_features == 50
        foretold[privileged] = model.logger.name_to_value["train/explained_variance"]
    assert foretold[True] > 0.9 > 0.3 > foretold[False]


def test_a_privileged_critic_is_told_of_the_car_that_was_cut_off_and_not_of_the_next():
    model = learner(make("dr=friction_0.1", "sim.max_steps=5", cars=8), privileged=True)
    asked, before, honest = [], [], model.race.step

    def step(action):
        before.append(model.race.privileged().clone())
        return honest(action)

    model.race.step = step  # type: ignore[method-assign]
    values = model._values
    model._values = lambda seen, told: asked.append(told.clone()) or values(seen, told)  # type: ignore
    model.learn(1)
    cut = (model.rollout.cut_off != 0).any(dim=1).nonzero()[:, 0].tolist()
    assert cut and len(asked) == len(cut) + 1  # the last is for what comes after the rollout
    for told, at in zip(asked, cut, strict=False):
        assert torch.equal(told, before[at]) and torch.equal(model.rollout.privileged[at], before[at])


def test_the_logged_reward_is_that_of_the_race():
    """Whatever the critic says of episodes that were cut off."""
    model = learner(make("sim.max_steps=10", cars=64))
    model.policy.value_net.bias.data += 100.0
    honest, rewards = model.race.step, []

    def step(action):
        taken = honest(action)
        rewards.append(taken.reward)
        return taken

    model.race.step = step  # type: ignore[method-assign]
    model.learn(1)
    assert model.logger.name_to_value["train/reward"] == float(torch.stack(rewards).mean())
    assert float(model.rollout.cut_off.max()) > 50.0  # the learner was told what was still to come


def mean_reward(model, steps):
    """Return the mean reward of the first and of the last rollout."""
    rewards = []

    def remember(local, _):
        if local["self"].num_timesteps % (64 * 32) == 0 and float(model.rollout.rewards[-1].abs().sum()) > 0:
            rewards.append(float(model.rollout.rewards.mean()))
        return True

    model.learn(steps, callback=remember)
    return np.mean(rewards[1:4]), np.mean(rewards[-4:])


QUICK = {"normalise": True, "target_kl": 0.02, "batch": 256}


@pytest.mark.parametrize("bf16", [False, True])
def test_a_policy_improves(bf16):
    if bf16 and not has_bf16(torch.device("cpu")):
        pytest.skip("this processor has no instructions for bf16")
    # a car that beginners get along with; the default one takes longer than a test has
    first, last = mean_reward(learner(make("vehicle=published", cars=64), bf16=bf16, **QUICK), 60_000)
    assert last > first + 0.02


def test_a_policy_that_is_blind_to_what_it_does_cannot_improve():
    """The same learner, but every car is driven by another one's actions: credit is lost, so must be learning."""
    race = make("vehicle=published", cars=64)
    honest = race.step
    race.step = lambda action: honest(action.roll(1, dims=0))  # type: ignore[method-assign]
    first, last = mean_reward(learner(race, **QUICK), 60_000)
    assert last < first + 0.01


def weights(model):
    return torch.cat([p.detach().flatten() for p in model.policy.parameters()])


def test_the_same_seed_gives_the_same_weights():
    runs = []
    for seed in (0, 0, 1):
        model = learner(make("dr=friction_0.02", cars=64, seeds=[seed]), seed=seed)
        model.learn(3 * 64 * 32)
        runs.append(weights(model))
    assert torch.equal(runs[0], runs[1]) and not torch.equal(runs[0], runs[2])


def test_the_learning_rate_follows_the_divergence():
    model = learner(target_kl=0.01)
    model._follow_divergence(True, 0.05)
    lowered = model.rate_factor
    model._follow_divergence(False, 0.001)
    assert lowered < 1.0 and model.rate_factor > lowered
    kept = model.rate_factor
    model._follow_divergence(False, 0.015)
    assert model.rate_factor == kept


def test_how_the_learning_rate_follows_stands_in_the_budget():
    model = learner(target_kl=0.01, kl_step=2.0, lowest_rate=0.3)
    model._follow_divergence(True, 0.05)
    assert model.rate_factor == 0.5
    model._follow_divergence(True, 0.05)
    assert model.rate_factor == 0.3
    assert not model._too_far(torch.tensor(0.015)) and model._too_far(torch.tensor(0.03))
    assert learner(target_kl=0.01, kl_largest=1.0)._too_far(torch.tensor(0.015))
    assert learner(adam_epsilon=1e-3).policy.optimizer.defaults["eps"] == 1e-3


BUDGETS = sorted(path.stem for path in (CONF / "budget").glob("*.yaml"))
OTHER = {"cars": 5, "gamma": 0.5, "target_kl": 0.5, "final_std": 0.5, "actor": [7], "critic": [7, 7, 7]}


@pytest.mark.parametrize("budget", BUDGETS)
def test_every_number_of_the_learner_stands_in_its_file(budget):
    fields = {field.name: field for field in dataclasses.fields(Budget)}
    settings = compose_settings(
        "train", [f"budget={budget}", *(f"budget.{key}={value}" for key, value in OTHER.items())]
    )
    assert set(settings["budget"]) - {"refinement", "ascent"} == set(fields)
    assert all(field.default is dataclasses.MISSING for field in fields.values())  # none in the code
    assert {key: settings["budget"][key] for key in OTHER} == OTHER
    Budget.of(settings["budget"])


@pytest.mark.parametrize("value", [-1, float("nan"), "word", None, [], True])
@pytest.mark.parametrize("name", [field.name for field in dataclasses.fields(Budget)])
def test_nonsense_is_refused_in_one_line(name, value):
    if (value is None and name in ("target_kl", "final_std")) or (value is True and name in SWITCHES):
        return
    with pytest.raises(ConfigError, match=rf"budget\.{name} = .*(allowed|expected)") as error:
        Budget.of({**SMALL, name: value})
    assert "\n" not in str(error.value)


def test_a_million_is_a_whole_number():
    assert Budget.of({**SMALL, "steps": 1e6}).steps == 1_000_000


def test_an_actor_that_went_too_far_rests_while_the_critic_learns():
    def changes(target):
        model = learner(target_kl=target)
        before = [[p.detach().clone() for p in group["params"]] for group in model.policy.optimizer.param_groups]
        model.learn(1)
        after = [group["params"] for group in model.policy.optimizer.param_groups]
        return [
            sum(float((new - old).detach().abs().sum()) for new, old in zip(*pair, strict=True))
            for pair in zip(after, before, strict=True)
        ]

    # the first minibatch never diverges (beyond rounding); whatever little it changed is too far for the second
    (strict_actor, strict_critic), (free_actor, free_critic) = changes(1e-6), changes(1.0)
    assert 0 < strict_actor < 0.2 * free_actor and strict_critic > 0.5 * free_critic


def test_the_noise_falls_to_where_the_budget_wants_it():
    model = learner(initial_std=0.5, final_std=0.05)
    noise = []
    model.learn(10 * 64 * 32, callback=lambda local, _: noise.append(float(model.policy.log_std[0].exp())) or True)
    steps = np.array(noise[::32])
    assert steps[0] == pytest.approx(0.5) and np.allclose(steps[1:] / steps[:-1], 0.1**0.1, rtol=1e-4)


def test_the_policy_that_is_saved_drives_as_the_one_that_learned():
    model = learner(normalise=True)
    model.learn(3 * 64 * 32)
    observation = model.race.observe()
    inside = actor_of(model)(model.normaliser(observation))
    assert (model.actor()(observation) - inside).abs().max() < 1e-4
    assert (actor_of(model)(observation) - inside).abs().max() > 1e-2  # folding made the difference


def test_the_paper_budget_is_the_papers():
    budget = Budget.of(compose_settings("train", ["budget=paper"])["budget"])
    assert (budget.steps, budget.cars, budget.rollout, budget.batch) == (120_000_000, 400, 1024, 1024)
    assert (budget.gamma, budget.epochs, budget.gae_lambda, budget.clip) == (0.99, 10, 0.95, 0.2)
    assert (budget.learning_rate, budget.final_learning_rate) == (1e-3, 1e-4)
    model = learner(make(cars=2), cars=2, rollout=8, batch=16, actor=budget.actor, critic=budget.critic)
    assert [layer.out_features for layer in model.policy.mlp_extractor.policy_net[::2]] == [256, 256]
    assert [layer.out_features for layer in model.policy.mlp_extractor.value_net[::2]] == [512, 512]
    assert model.policy.mlp_extractor.policy_net[1].negative_slope == 0.2
    schedule = model.lr_schedule
    assert schedule(1.0) == pytest.approx(1e-3) and schedule(0.0) == pytest.approx(1e-3)


@pytest.mark.parametrize(
    "change, said",
    [
        ({"steps": 0}, "steps"),
        ({"cars": 1.5}, "cars"),
        ({"gamma": 1.5}, "gamma"),
        ({"stpes": 3}, "steps"),
        ({"learning_rate": -1}, "learning_rate"),
        ({"learning_rate": "fast"}, "budget"),
    ],
)
def test_wrong_budgets_are_refused(change, said):
    with pytest.raises(ConfigError, match=said):
        Budget.of({**SMALL, **change})
