"""A policy at the wheel: it drives as in a race, ahead of its data's age, and stands where they cannot be trusted."""

import math
import shutil

import pytest
import torch

from racerl.config import compose_settings
from racerl.control.networks import RecurrentNetwork, build_network
from racerl.control.policy import Policy, RecurrentPolicy, load_policy, save_policy
from racerl.deploy.pilot import Guard, Pilot, Sensed
from racerl.env.observations import settings_of
from racerl.errors import RacerlError
from racerl.evaluate.evaluate import build_evaluation_race
from racerl.train.train import train
from racerl.vehicle.integrate import advance
from racerl.vehicle.ops import TORCH

DT = 0.05
AT_ONCE = Guard(settle=0.0)


@pytest.fixture
def race(smoke_run):
    """Return a race of one car, as the policy was trained in."""
    settings = compose_settings("train", ["dr=none"])
    return build_evaluation_race(settings, [0], torch.device("cpu"))


def sensed(race, time):
    return Sensed(time, *race.state[:8, 0].tolist())


def awake(pilot, what, now):
    """Let a pilot see sound data once, after which it may drive."""
    return pilot.drive(what._replace(time=now), now)


def test_it_gives_the_orders_that_the_policy_gives_in_a_race(race, smoke_run):
    assert 5 < drives_alike(race, smoke_run) < 24


def test_a_policy_that_looks_back_drives_as_in_a_race(smoke_run, tmp_path):
    settings = compose_settings("train", ["dr=none", "obs=history", "obs.steps=3"])
    race = build_evaluation_race(settings, [0], torch.device("cpu"))
    run = shutil.copytree(smoke_run, tmp_path / "run")
    torch.manual_seed(0)
    seen = settings_of("history", race.observation)
    save_policy(Policy(build_network([71, 16, 2]), seen, load_policy(smoke_run).action), run)
    assert drives_alike(race, run) > 5


def test_a_policy_that_remembers_drives_as_in_a_race(race, smoke_run, tmp_path):
    run = shutil.copytree(smoke_run, tmp_path / "run")
    torch.manual_seed(0)
    before = load_policy(smoke_run)
    save_policy(RecurrentPolicy(RecurrentNetwork(50, 16, 2), before.observation, before.action), run)
    assert drives_alike(race, run) > 5


def drives_alike(race, run):
    policy, pilot = load_policy(run), Pilot(run, guard=Guard(off_track=9.0, settle=0.0))
    for number in range(25):
        now = number * DT
        order = pilot.drive(sensed(race, now), now)
        step = race.step(policy.act(race))
        if bool(step.terminated.any()):
            break
        assert order.why == ""
        assert order.delta_ref == pytest.approx(float(step.command[0]), abs=1e-5)
        assert order.drive_ref == pytest.approx(float(step.command[1]), abs=1e-4)
    return number


def test_what_is_old_and_acts_late_is_driven_forward_with_the_orders_that_act_then(race, smoke_run):
    pilot = Pilot(smoke_run, delay=0.02, guard=AT_ONCE)
    start = Sensed(0.0, *race.state[:8, 0].tolist())
    orders = []
    for number in range(3):
        now = number * DT
        orders.append(pilot.drive(start._replace(time=now), now))
    measured = start._replace(time=0.09)
    found = pilot.predict(measured, 0.13)
    state, race_vehicle = torch.tensor(start[1:])[:, None], race.vehicle
    for begins, order in ((0.09, orders[1]), (0.12, orders[2])):  # the third acts from 0.10 + 0.02 on
        command = torch.tensor([[order.delta_ref], [order.drive_ref]])
        steps = 6 if begins == 0.09 else 2
        state = advance(race_vehicle, state, command, 0.005, steps, TORCH)
    assert torch.allclose(found, state, atol=1e-5)
    assert not torch.allclose(found[:2], torch.tensor(start[1:3])[:, None], atol=0.01)


def test_its_orders_are_for_the_car_as_it_will_be(race, smoke_run):
    """Data of 0.1 s ago and what they have come to by now ask for the same."""
    late, soon = (Pilot(smoke_run, guard=AT_ONCE) for _ in range(2))
    for pilot in (late, soon):
        pilot.policy = Policy(turning(pilot), pilot.policy.observation, pilot.policy.action)
    before = Sensed(0.0, *race.state[:8, 0].tolist())._replace(yaw_rate=1.0, v_x=2.0, omega=2.0)
    come = late.predict(before, 0.1)[:8, 0].tolist()
    first, second = late.drive(before, 0.1), soon.drive(Sensed(0.1, *come), 0.1)
    assert first[:2] == pytest.approx(second[:2], abs=1e-5)
    there = Pilot(smoke_run, guard=AT_ONCE)
    there.policy = late.policy
    assert there.drive(before._replace(time=0.1), 0.1).delta_ref != pytest.approx(first.delta_ref, abs=1e-3)


def turning(pilot):
    """Return a network that steers by where it is and how it turns."""
    torch.manual_seed(0)
    network = build_network([pilot.observation.size, 2])
    torch.nn.init.normal_(network[0].weight, std=0.1)
    torch.nn.init.zeros_(network[0].bias)
    return network.requires_grad_(False)


def test_a_limit_of_speed_is_what_the_car_is_driven_forward_with(race, smoke_run):
    pilot = Pilot(smoke_run, guard=AT_ONCE, most=1.0)
    pilot.policy = Policy(constant(pilot, 0.0), pilot.policy.observation, pilot.policy.action)
    orders = [pilot.drive(sensed(race, number * DT), number * DT) for number in range(20)]
    assert [order.drive_ref for order in orders[-5:]] == [1.0] * 5
    assert float(pilot.predict(sensed(race, 0.7), 0.95)[7]) == pytest.approx(1.0, abs=0.05)


def test_a_steering_angle_that_nobody_measures_is_the_models(race, smoke_run):
    pilot = Pilot(smoke_run, guard=AT_ONCE)
    pilot.policy = Policy(constant(pilot, 0.6), pilot.policy.observation, pilot.policy.action)
    lag = float(pilot.vehicle.steering.time_constant)
    for number in range(4):
        now = number * DT
        order = pilot.drive(sensed(race, now)._replace(delta=math.nan), now)
    assert order.delta_ref == pytest.approx(0.3)
    # three periods after the first order
    assert float(pilot.predict(sensed(race, now)._replace(delta=math.nan), now)[6]) == pytest.approx(
        0.3 * (1.0 - math.exp(-3 * DT / lag)), abs=1e-4
    )


def constant(pilot, steering):
    """Return a network that always steers so."""
    network = build_network([pilot.observation.size, 2])
    torch.nn.init.zeros_(network[0].weight)
    network[0].bias.data = torch.tensor([steering, 0.2])
    return network.requires_grad_(False)


@pytest.mark.parametrize(
    ("change", "late", "said"),
    [
        ({"yaw": math.nan}, DT, "no finite yaw"),
        ({"v_x": math.inf, "omega": math.nan}, DT, "no finite v_x, omega"),
        ({"delta": math.inf}, DT, "no finite delta"),
        ({"time": 1.0 - 0.25}, DT, "the data are 0.30 s old"),
        ({"time": 1.0 + 2 * DT}, DT, "the data are -0.05 s old"),
        ({"x": 40.0, "y": -30.0}, DT, "m off the track"),
        ({}, 3 * DT, "asked after 0.15 s"),
    ],
)
def test_it_stands_where_it_must_not_drive_and_drives_again_after_a_while(race, smoke_run, change, late, said):
    pilot = Pilot(smoke_run, guard=Guard(settle=0.2))
    what, now, waited = sensed(race, 0.0), 1.0, 0
    while (order := awake(pilot, what, now)).why:
        assert order.drive_ref == 0.0 and "sound" in order.why
        now, waited = now + DT, waited + 1
        assert waited < 10
    assert waited == 4 and order.drive_ref > 0.0
    now += late
    bad = what._replace(time=now)._replace(**{key: value for key, value in change.items() if key != "time"})
    bad = bad._replace(time=now + change["time"] - 1.0 - DT) if "time" in change else bad
    stopped = pilot.drive(bad, now)
    assert stopped.drive_ref == 0.0 and said in stopped.why and stopped.delta_ref == order.delta_ref
    again = [awake(pilot, what, now + DT * (1 + number)) for number in range(6)]
    assert [not each.why for each in again] == [False] * 4 + [True] * 2
    first = again[4]
    assert first.drive_ref == pytest.approx(what.omega, abs=0.3)  # goes on from where the wheel is


def test_a_policy_that_commands_a_motors_current_is_refused(tmp_path):
    """Its zero is no stop: the car would coast."""
    train(
        compose_settings("train", ["budget=smoke", "threads=1", "action=current", "sim=motor_current"]),
        tmp_path / "run",
    )
    with pytest.raises(RacerlError, match="commands a motor_current"):
        Pilot(tmp_path / "run")


def test_a_run_that_cannot_drive_is_told(tmp_path, smoke_run):
    with pytest.raises(RacerlError, match="no racerl run folder"):
        Pilot(tmp_path)
    with pytest.raises(RacerlError, match=r"guard\.stale = -1"):
        Guard(stale=-1.0)
    with pytest.raises(RacerlError, match="delay = 3"):
        Pilot(smoke_run, delay=3.0)
