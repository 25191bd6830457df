"""The ascent along the gradient of what a policy drives: is it the gradient, does it climb, how does it go on."""

from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch
import yaml

from racerl.assemble import build_races
from racerl.config import compose_settings
from racerl.control.networks import RecurrentNetwork, build_network
from racerl.control.policy import UNREFINED, Policy, RecurrentPolicy, load_policy
from racerl.env.termination import Crash
from racerl.errors import ConfigError
from racerl.evaluate.evaluate import learned
from racerl.train import session
from racerl.train import train as training
from racerl.train.ascent import Ascent, Climb, _Limited
from racerl.train.improve import FILE
from racerl.train.train import train
from tests.train.pulled import Plug, logged, pull_at
from tests.train.short import ascent

SMOKE = ["budget=smoke", "threads=1", "budget.steps=1024"]
PLAN = Ascent(
    updates=6,
    evaluations=2,
    cars=16,
    horizon=20,
    between=3,
    episode=60,
    again=0.5,
    learning_rate=[0.01, 0.01],
    betas=[0.9, 0.99],
    gradient_norm=1e9,
    price=400.0,
    reserve=0.05,
)
STEP = 2e-4  # of finite differences: larger ones cross kinks of the network
WORLDS = {
    "plain": [],
    "drawn": ["+dr=friction_0.02", "dr.sigma=0.1"],
    "late": ["vehicle=f1tenth", "+vehicle/effect=[steering_delay,drive_delay,pose_latency]"],
    "history": ["obs=history"],
    "progress": ["obs=progress"],
    "direct": ["action=speed"],
    "two tracks": ["track=[oval,bean]"],
}


def climb(plan=PLAN, *words, recurrent=False):
    settings = compose_settings("train", [*SMOKE, *words])
    torch.manual_seed(0)
    lead, race = (
        build_races(settings, cars=plan.cars, seed=0, device=torch.device("cpu"), termination=end)
        for end in (None, Crash())
    )
    if recurrent:
        policy = RecurrentPolicy(RecurrentNetwork(lead.observation.size, 8, 2), {}, {})
    else:
        policy = Policy(build_network([lead.observation.size, 8, 2]), {}, {})
    return Climb(plan, policy, lead, race, 0)


def steady(found):
    """Give the policy a gentle hand, and let it drive a while, so that nothing is at a limit or a crash."""
    with torch.no_grad():
        for each in found.network.parameters():
            each.mul_(0.3)
        for _ in range(3):
            found.practice.drive()
    return found


@pytest.mark.parametrize(("world", "recurrent"), [*((world, False) for world in WORLDS), ("plain", True)])
def test_the_gradient_is_that_of_finite_differences(world, recurrent):
    """Along random directions of all weights, through car, track, observation, action and memory."""
    found = steady(climb(replace(PLAN, horizon=10, price=30.0, reserve=0.4), *WORLDS[world], recurrent=recurrent))
    weights = list(found.network.parameters())

    def made():
        return found._drive()[0].double().mean()

    slopes = torch.autograd.grad(made(), weights)
    generator = torch.Generator().manual_seed(1)
    for _ in range(3):
        along = [torch.randn(each.shape, generator=generator) for each in weights]
        expected = sum(float((slope * way).sum()) for slope, way in zip(slopes, along, strict=True))
        outcomes = []
        for sign in (1.0, -1.0):
            with torch.no_grad():
                for each, way in zip(weights, along, strict=True):
                    each.add_(sign * STEP * way)
                outcomes.append(float(made()))
                for each, way in zip(weights, along, strict=True):
                    each.sub_(sign * STEP * way)
        measured = (outcomes[0] - outcomes[1]) / (2 * STEP)
        assert expected == pytest.approx(measured, rel=0.03, abs=0.01)
        assert abs(measured) > 0.02


def test_an_output_comes_back_from_its_limit_and_goes_no_further():
    outputs = torch.tensor([1.5, 1.5, -1.5, -1.5, 0.5], requires_grad=True)
    limited = _Limited.apply(outputs)
    assert limited.tolist() == [1.0, 1.0, -1.0, -1.0, 0.5]
    # of what is made less: descent by 1 leads down, by −1 up
    limited.backward(torch.tensor([1.0, -1.0, 1.0, -1.0, 1.0]))
    assert outputs.grad.tolist() == [1.0, 0.0, 0.0, -1.0, 1.0]


def test_it_learns_to_go_faster():
    plan = replace(PLAN, cars=32, episode=20, price=0.0)
    found = climb(plan, "track=oval")
    made = [found.advance()["fitness"] for _ in range(15)]
    assert sum(made[-3:]) > 1.1 * sum(made[:3]) > 0.0


def test_the_boundary_has_a_price():
    """What is close to it makes less, and what has crashed counts as far beyond it."""
    found = steady(climb(replace(PLAN, horizon=5)))
    found.settings = replace(found.settings, price=0.0)
    free, crashed = found._drive()
    found.settings = replace(found.settings, price=100.0, reserve=0.5)
    narrow, _ = found._drive()
    assert not crashed.any() and bool((narrow < free).all())
    with torch.no_grad():
        found.network[-1].bias.copy_(torch.tensor([9.0, 9.0]))  # full lock, full throttle
    found.settings = replace(PLAN, horizon=60, reserve=0.0)
    lost, crashed = found._drive()
    assert crashed.all() and float(lost.detach().max()) < 0.0


@pytest.mark.parametrize(("heading", "dear"), [(1.2, False), (1.5, True), (-1.5, True)])
def test_a_spin_has_a_price_before_it_is_one(heading, dear):
    """Of cars in the middle of the track; a policy that drives sideways would fall over that edge unwarned."""
    found = steady(climb(replace(PLAN, horizon=1, reserve=0.1, price=0.0), "track=oval"))
    lead = found.lead
    s = torch.linspace(0.0, lead.track.length, PLAN.cars + 1)[1:]
    state = torch.zeros_like(lead.state)
    state[0], state[1], state[2] = lead.frame.position(s, torch.zeros_like(s))
    state[2] += heading
    state[3] = state[7] = 0.5
    lead.put(torch.arange(PLAN.cars), state, torch.zeros(2, PLAN.cars))
    free, crashed = found._drive()
    found.settings = replace(found.settings, price=100.0)
    priced, _ = found._drive()
    assert not crashed.any()
    assert bool((priced < free - 0.001).all()) if dear else torch.equal(priced, free)


def test_cars_that_crash_or_fail_leave_the_others_their_gradient():
    found = climb(replace(PLAN, horizon=80))
    with torch.no_grad():
        found.network[-1].bias.copy_(torch.tensor([0.9, 0.9]))
    made, crashed = found._drive()
    assert crashed.all()
    assert _norm(made, found) > 0.0  # of what they did before
    with torch.no_grad():
        found.practice.drive()
    found.settings = replace(PLAN, horizon=5)
    sound = _norm(found._drive()[0][1:], found)
    found.lead.state[5, 0] = 1e30  # a yaw rate at which the integration fails
    made, crashed = found._drive()
    assert found.race.faults > 0 and crashed[0]
    assert _norm(made[1:], found) == pytest.approx(sound, rel=1e-5)
    assert 0.0 < _norm(made, found) < float("inf")


def _norm(made, found):
    slopes = torch.autograd.grad(made.sum(), list(found.network.parameters()), retain_graph=True)
    return float(torch.cat([slope.flatten() for slope in slopes]).norm())


@pytest.mark.parametrize("period", [0.0, pytest.param(1e6, marks=pytest.mark.slow)])
def test_an_interrupted_ascent_goes_on_where_it_was(period, tmp_path, monkeypatch):
    words = [*SMOKE, ascent(), "+dr=friction_0.02"]
    whole = train(compose_settings("train", words), tmp_path / "whole")
    monkeypatch.setattr(session, "CHECKPOINT_PERIOD", period)
    with pytest.raises(Plug):
        train(compose_settings("train", words), tmp_path / "killed", pull_at(2 * 16 * 25, stage="refine"))
    monkeypatch.setattr(training, "create_algorithm", lambda _: SimpleNamespace(train=None))  # not asked again
    again = train(compose_settings("train", words), tmp_path / "killed")
    assert {**again, "seconds": 0.0} == {**whole, "seconds": 0.0} and whole["ascended"] == 4
    assert whole["steps"] == 1024 + 4 * 16 * 25
    one, other = (load_policy(tmp_path / run).network.state_dict() for run in ("whole", "killed"))
    assert all(torch.equal(one[name], other[name]) for name in one)
    assert not (tmp_path / "killed" / FILE).exists() and (tmp_path / "killed" / UNREFINED).is_dir()
    assert logged(tmp_path / "killed") == logged(tmp_path / "whole")


def test_its_policies_say_how_they_were_made():
    assert learned(compose_settings("train", [])) == "PPO refined"


@pytest.mark.parametrize(
    ("word", "said"),
    [
        (ascent(cars=0), "cars"),
        (ascent(learning_rate=0.1), "two numbers"),
        (ascent(betas="[0.9,1.0]"), "budget.ascent.betas = 1.0"),
        (ascent(price=-1), "price"),
        (ascent(gradient_norm=0), "gradient_norm"),
        (ascent(pairs=2), "no setting 'pairs'"),
        ("+budget.ascent=3", "or null"),
    ],
)
def test_wrong_settings_are_refused_before_anything_is_trained(word, said, tmp_path):
    with pytest.raises(ConfigError, match=said):
        train(compose_settings("train", [*SMOKE, word]), tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_a_budget_ends_with_one_of_both(tmp_path):
    words = ["+budget.refinement={generations:2}"]
    with pytest.raises(ConfigError, match=r"budget\.refinement and budget\.ascent: one of them is allowed"):
        train(compose_settings("train", words), tmp_path / "run")


def test_a_car_without_a_gradient_is_refused(tmp_path):
    car = {**compose_settings("train", [])["vehicle"], "body": "commonroad_mb"}
    (tmp_path / "car.yaml").write_text(yaml.safe_dump(car))
    with pytest.raises(ConfigError, match=r"vehicle\.body = commonroad_mb has none; use budget=evolution"):
        train(compose_settings("train", [f"vehicle={tmp_path}/car.yaml"]), tmp_path / "run")
