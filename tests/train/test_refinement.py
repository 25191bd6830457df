"""The evolution strategy that refines a policy: its arithmetic, what it learns, and how it goes on."""

import copy
from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch

from racerl.assemble import build_races
from racerl.config import compose_settings
from racerl.control.networks import RecurrentNetwork, build_network, maps
from racerl.control.policy import UNREFINED, Policy, RecurrentPolicy, load_policy
from racerl.env.termination import Crash
from racerl.errors import ConfigError, RunError
from racerl.evaluate.evaluate import evaluate
from racerl.train import session
from racerl.train import train as training
from racerl.train.checkpoint import recover
from racerl.train.improve import FILE
from racerl.train.refinement import Refinement, Search
from racerl.train.train import train
from tests.train.pulled import logged
from tests.train.short import refinement

PLAIN = ["budget=smoke", "threads=1", "budget.steps=1024"]
SMOKE = [*PLAIN, refinement()]
PLAN = Refinement(
    generations=6,
    evaluations=2,
    pairs=32,
    horizon=20,
    between=3,
    episode=60,
    again=0.5,
    perturbation=[0.1, 0.1],
    step=[0.1, 0.1],
    most=3.0,
    price=100.0,
    reserve=0.0,
    momentum=0.5,
)


def search(plan=PLAN, *words, hidden=8, seed=0, recurrent=False):
    settings = compose_settings("train", [*SMOKE, *words])
    torch.manual_seed(seed)
    lead, race = (
        build_races(
            settings, cars=plan.pairs, seed=seed, device=torch.device("cpu"), times=times, termination=termination
        )
        for times, termination in ((1, None), (2, Crash()))
    )
    size = lead.observation.size
    if recurrent:
        policy = RecurrentPolicy(RecurrentNetwork(size, hidden, 2).requires_grad_(False), {}, {})
    else:
        policy = Policy(build_network([size, hidden, 2]).requires_grad_(False), {}, {})
    return Search(plan, policy, lead, race, seed)


def test_both_cars_of_a_pair_start_alike_in_one_world():
    found = search(PLAN, "+dr=friction_0.02", "dr.sigma=0.1")
    for _ in range(5):
        found.lead.step(found.network(found.lead.observe()))
    found.practice.copy_into(found.race)
    for kept in (found.race.state, found.race.command, found.race.draws.values, found.race.place):
        ahead, behind = kept.chunk(2, dim=-1)
        assert torch.equal(ahead, behind)
    assert torch.equal(found.race.state[:, : PLAN.pairs], found.lead.state)
    assert found.lead.draws.values.std() > 0.01


@pytest.mark.parametrize("recurrent", [False, True])
def test_perturbed_actions_are_those_of_perturbed_networks(recurrent):
    found = search(recurrent=recurrent)
    found.practice.drive()
    observation, scales = found.race.observe(), found._scales()
    normal = found._normal(scales)
    sizes = [torch.tensor(0.3), torch.tensor(0.2)] + [torch.tensor(0.1)] * (len(normal) - 2)
    memory = torch.cat([found.practice.memory] * 2)
    assert memory.shape[1] == (8 if recurrent else 0) and (not recurrent or memory.abs().max() > 0.01)
    actions, remembered = found._perturbed(observation, memory, normal, sizes)
    for car, sign in ((4, 1.0), (4 + PLAN.pairs, -1.0)):
        policy = copy.deepcopy(found.practice.policy)
        for (weights, biases), (a, b), size in zip(maps(policy.network), normal, sizes, strict=True):
            change = sign * size * torch.outer(a[4], b[4])
            weights.add_(change[:, :-1])
            biases.add_(change[:, -1])
        alone, then = policy.decide(observation[car][None], memory[car][None])
        torch.testing.assert_close(actions[car].clamp(-1, 1), alone[0])
        torch.testing.assert_close(remembered[car], then[0])


def test_pairs_begin_with_what_their_car_remembers():
    """Nothing, where its episode has just begun."""
    found = search(replace(PLAN, episode=6, between=3), recurrent=True)
    for _ in range(4):
        found.practice.drive()
    fresh = found.lead.age == 0
    assert fresh.any() and (found.practice.memory[fresh] == 0.0).all()
    assert found.practice.memory[~fresh].abs().max(dim=1).values.min() > 0.0
    found.practice.copy_into(found.race)
    given, seen = found._perturbed, []
    found._perturbed = lambda x, memory, *rest: seen.append(memory) or given(x, memory, *rest)
    found._fitness(found._normal(found._scales()), [torch.zeros(())] * 5)
    assert torch.equal(seen[0], torch.cat([found.practice.memory] * 2))


def test_inputs_count_by_their_size():
    """An input a hundred times as large is perturbed a hundredth as much, so that it does not decide alone."""
    found = search()
    sizes = torch.tensor([1.0, 100.0] + [1.0] * 49)
    a, b = found._normal([sizes, torch.ones(9)])[0]
    assert (b * sizes).std(dim=0)[:2].tolist() == pytest.approx([1.0, 1.0], rel=0.4)
    assert a.std() == pytest.approx(1.0, rel=0.3)


def test_it_learns_to_go_faster():
    """A car that is driven by two numbers alone makes more of its way in a second when it speeds up."""
    plan = replace(PLAN, generations=15, pairs=64, step=[0.3, 0.3], perturbation=[0.3, 0.3], episode=20, price=0.0)
    found = search(plan, "track=oval")
    for weights, _ in found.maps:
        weights.zero_()
    found.maps[0][1].fill_(0.1)
    found.maps[1][1].copy_(torch.tensor([0.0, -0.2]))
    fitness = [found.advance()["fitness"] for _ in range(plan.generations)]
    assert fitness[-1] > 1.1 * fitness[0]


@pytest.mark.parametrize(("most", "alike"), [(3.0, True), (1e6, False)])
def test_a_crash_does_not_decide_alone(most, alike, monkeypatch):
    """Beyond `most` times the median difference it does not matter by how much one of a pair wins."""
    steps = []
    for far in (1.0, 50.0):
        found = search(replace(PLAN, most=most))
        before = found.maps[0][0].clone()
        won = torch.linspace(0.05, 0.15, 2 * PLAN.pairs).roll(5)
        won[3] += far
        monkeypatch.setattr(found, "_fitness", lambda normal, sizes, won=won: won)
        found.crashed = torch.zeros(1)
        found.advance()
        steps.append(found.maps[0][0] - before)
    assert torch.equal(*steps) == alike


def test_the_boundary_has_a_price():
    """Whoever crosses it pays, also for coming closer than the reserve; who keeps away makes what he drives."""
    found = []
    for price, reserve in ((0.0, 0.0), (100.0, 0.0), (100.0, 0.1)):
        one = search(replace(PLAN, price=price, reserve=reserve, horizon=30), "track=oval")
        for weights, _ in one.maps:
            weights.zero_()
        one.maps[1][1].copy_(torch.tensor([0.4, 0.4]))  # bears off
        one.practice.copy_into(one.race)
        normal = one._normal(one._scales())
        found.append(one._fitness(normal, [torch.zeros(())] * 2))
    free, paid, closer = found
    assert one.crashed.any() and (paid[one.crashed] < free[one.crashed]).all()
    assert (closer < paid).any() and (closer <= paid).all() and (closer == free).any()


def test_what_the_price_is_of():
    """Driving 0.02 m inside the boundary, 0.03 m closer than the reserve, costs 100 · 0.03 a second.

    A car that has crashed makes nothing any more and pays for 0.25 m: a crash saves nobody the price.
    """
    one = search(replace(PLAN, price=100.0, reserve=0.05), "track=oval")
    crashed = torch.arange(64) < 32
    steps = iter(
        SimpleNamespace(
            terminated=crashed & (number == 10),
            progress=torch.full((64,), 0.3),
            margin=torch.full((64,), 0.02),
            observation=one.race.observe(),
        )
        for number in range(PLAN.horizon)
    )
    dt = one.race.timing.dt
    one.race = SimpleNamespace(
        count=64,
        device=one.race.device,
        observe=one.race.observe,
        timing=one.race.timing,
        step=lambda action: next(steps),
    )
    normal = one._normal(one._scales())
    fitness = one._fitness(normal, [torch.zeros(())] * 2)
    drives, lies = 0.3 - 100 * 0.03 * dt, -100 * 0.25 * dt
    assert fitness[32:].tolist() == pytest.approx([20 * drives] * 32)
    assert fitness[:32].tolist() == pytest.approx([10 * drives + 10 * lies] * 32)


def test_a_start_that_ends_in_a_crash_is_tried_again():
    """Cars that steer hard leave the track; without a second try their next episode begins elsewhere."""
    for again, share in ((0.0, 0.0), (0.999, 1.0)):
        found = search(replace(PLAN, again=again, between=40, episode=10**6), "track=oval")
        for weights, _ in found.maps:
            weights.zero_()
        found.maps[1][1].copy_(torch.tensor([1.0, 0.5]))
        before = found.practice.starts.clone()
        found.practice.drive()
        assert (found.lead.age < 40).all()  # all have crashed
        assert (found.practice.starts == before).all(dim=0).float().mean() == share
    # and the start that counts is where the episode began
    steps = int(found.lead.age.max())
    assert steps > 0 and torch.equal(
        found.practice.starts[:, found.lead.age == 0], found.lead.state[:, found.lead.age == 0]
    )


def test_a_share_of_the_pairs_begins_at_starts():
    found = search(replace(PLAN, between=6, episode=60))
    for _ in range(4):
        found.practice.drive()
        assert 0.05 < (found.lead.age == 0).float().mean() < 0.4


class Killed(Exception):
    """The process was killed."""


@pytest.mark.parametrize(
    "period",
    [
        pytest.param(0.0, id="from its checkpoint"),
        pytest.param(1e6, id="from the policy before it", marks=pytest.mark.slow),
    ],
)
def test_an_interrupted_refinement_goes_on_where_it_was(period, tmp_path, monkeypatch):
    words = [*SMOKE, "budget.refinement.generations=6", "budget.refinement.evaluations=6", "+dr=friction_0.02"]
    whole = train(compose_settings("train", words), tmp_path / "whole")
    monkeypatch.setattr(session, "CHECKPOINT_PERIOD", period)

    def kill(progress):
        if progress.stage == "refine" and progress.steps > 3 * 16 * (2 * 20 + 5):
            raise Killed

    with pytest.raises(Killed):
        train(compose_settings("train", words), tmp_path / "killed", kill)
    monkeypatch.setattr(training, "create_algorithm", lambda asked: SimpleNamespace(train=None))  # not asked again
    again = train(compose_settings("train", words), tmp_path / "killed")
    assert {**again, "seconds": 0.0} == {**whole, "seconds": 0.0}
    assert again["seconds"] < 3.0 * whole["seconds"]  # what was before the interruption counts once
    one, other = (load_policy(tmp_path / run).network.state_dict() for run in ("whole", "killed"))
    assert all(torch.equal(one[name], other[name]) for name in one)
    assert not (tmp_path / "killed" / FILE).exists()
    assert logged(tmp_path / "killed") == logged(tmp_path / "whole")


def test_the_policy_before_it_is_kept(tmp_path):
    facts = train(compose_settings("train", SMOKE), tmp_path / "run")
    plain = train(compose_settings("train", PLAIN), tmp_path / "plain")
    before, alone = (
        load_policy(folder).network.state_dict() for folder in (tmp_path / "run" / UNREFINED, tmp_path / "plain")
    )
    assert all(torch.equal(before[name], alone[name]) for name in alone)
    assert facts["refined"] == 2 and "refined" not in plain
    assert facts["steps"] == plain["steps"] + 2 * 16 * (2 * 20 + 5)
    words = ["laps=1", "seeds=[0]"]
    raced, other = (
        evaluate(compose_settings("evaluate", [f"run='{run}'", *words]), tmp_path / name)
        for run, name in ((tmp_path / "run" / UNREFINED, "raced"), (tmp_path / "plain", "other"))
    )
    assert raced["label"] == other["label"] and raced["rows"] == other["rows"]
    assert raced["trained"]["steps"] == plain["steps"] and 0.0 < raced["trained"]["seconds"] < facts["seconds"]


def test_a_damaged_checkpoint_is_one_line(tmp_path):
    found = search()
    (tmp_path / FILE).write_bytes(b"not tensors")
    with pytest.raises(RunError, match="is damaged"):
        recover(tmp_path / FILE, found.restore)


@pytest.mark.parametrize(
    ("word", "said"),
    [
        ("budget.refinement.pairs=0", "pairs"),
        ("budget.refinement.step=0.1", "two numbers"),
        ("budget.refinement.perturbation=[0.1,-1]", "perturbation"),
        ("budget.refinement.momentum=1.5", "momentum"),
        ("budget.refinement.most=0", "most"),
        ("budget.refinement.price=-1", "price"),
        ("budget.refinement.reserve=x", "reserve"),
        ("budget.refinement=3", "or null"),
        ("+budget.refinement.speed=3", "no setting 'speed'"),
    ],
)
def test_wrong_settings_are_refused_before_anything_is_trained(word, said, tmp_path):
    with pytest.raises(ConfigError, match=said):
        train(compose_settings("train", [*SMOKE, word]), tmp_path / "run")
    assert not (tmp_path / "run").exists()
