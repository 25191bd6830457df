"""The race: reward, episodes, restarts, faults, determinism."""

import dataclasses
import logging
import math
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
import torch

from racerl.assemble import build_race
from racerl.config import compose_settings
from racerl.env.observations import OBSERVATION_LIMIT
from racerl.env.race import Race, Timing
from racerl.env.termination import Crash
from racerl.errors import ConfigError
from racerl.vehicle.vehicle import STATE

X, Y, YAW, V_X = (STATE.index(name) for name in ("x", "y", "yaw", "v_x"))


def make(*overrides: str, cars: int = 8, seeds=(0,), **kwargs) -> Race:
    return build_race(compose_settings("train", overrides), cars=cars, seeds=list(seeds), **kwargs)


def place(race: Race, s: float, n: float = 0.0, speed: float = 2.0, heading: float = 0.0) -> None:
    """Put all cars at (s, n)."""
    column = torch.full((race.count,), s)
    x, y, yaw = race.frame.position(column, torch.full_like(column, n))
    race.state = torch.zeros_like(race.state)
    race.state[X], race.state[Y], race.state[YAW], race.state[V_X], race.state[-1] = x, y, yaw + heading, speed, speed
    race.command = torch.stack([torch.zeros_like(x), torch.full_like(x, speed)])
    race.place, _ = race.frame.locate(x, y, yaw + heading, column)
    race.travelled = race.s.double()


@contextmanager
def nothing_waits() -> Iterator[None]:
    """Fail where the host asks for a number: on a GPU it would wait for it."""

    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("the host waits for the device")

    with pytest.MonkeyPatch.context() as patch:
        for name in ("__bool__", "__int__", "__float__", "__index__", "item", "tolist", "nonzero", "numpy"):
            patch.setattr(torch.Tensor, name, refuse)
        yield


def test_cars_start_anywhere_on_the_centreline_along_it():
    race = make(cars=4000)
    assert (race.n.abs() < 1e-4).all() and (race.heading.abs() < 1e-4).all()
    assert 0.5 <= float(race.v_x.min()) < 0.52 and 1.98 < float(race.v_x.max()) <= 2.0
    assert torch.histc(race.s, 10, 0, race.track.length).min() > 300
    assert torch.equal(race.omega, race.v_x) and torch.equal(race.command[1], race.v_x)


def test_reward_is_the_progress():
    race = make(cars=16)
    total = torch.zeros(16)
    start = race.travelled.clone()
    for _ in range(10):
        step = race.step(torch.zeros(16, 2))
        total += step.reward
        if step.terminated.any():
            pytest.skip("a car left the track")
    assert torch.allclose(total.double(), race.travelled - start, atol=1e-5)
    assert (total > 0).all()


def test_leaving_the_track_costs_one_and_starts_over():
    race = make(cars=1)
    place(race, s=1.0, n=0.45, speed=3.0, heading=0.8)
    step = race.step(torch.zeros(1, 2))
    assert float(step.reward) == -1.0 and bool(step.terminated) and not bool(step.truncated)
    assert float(step.margin) < 0 and float(race.margin) > 0.49 and int(race.age) == 0
    assert not torch.equal(step.observation, step.final_observation)


@pytest.mark.parametrize("n, margin", [(0.0, 0.5), (0.4, 0.1), (-0.7, -0.2)])
def test_margin_is_the_distance_to_the_nearer_boundary(n, margin):
    race = make(cars=1)
    place(race, s=1.0, n=n)
    assert float(race.margin) == pytest.approx(margin, abs=1e-4)


def test_an_episode_is_cut_off_not_ended_after_its_steps():
    race = make("sim.max_steps=3", cars=1)
    place(race, s=0.5)
    steps = [race.step(torch.zeros(1, 2)) for _ in range(3)]
    assert [bool(step.truncated) for step in steps] == [False, False, True]
    assert not any(bool(step.terminated) for step in steps) and float(steps[-1].reward) > 0


def test_a_crash_needs_more_than_leaving_the_track():
    race = make(cars=1, termination=Crash())
    place(race, s=1.0, n=0.6, speed=1.0)
    assert not bool(race.step(torch.zeros(1, 2)).terminated)
    place(race, s=1.0, n=0.75, speed=1.0)
    assert bool(race.step(torch.zeros(1, 2)).terminated)


def test_a_spin_ends_an_episode_of_training():
    race = make(cars=1)
    place(race, s=1.0, heading=-math.pi / 2 - 0.1, speed=0.5)
    step = race.step(torch.zeros(1, 2))
    assert bool(step.terminated) and float(step.reward) == -1.0 and float(step.margin) > 0
    place(race, s=1.0, heading=math.pi / 2 - 0.1, speed=0.5)
    assert not bool(race.step(torch.zeros(1, 2)).terminated)


def test_a_spin_and_a_stop_are_crashes():
    race = make(cars=1, termination=Crash())
    place(race, s=1.0, heading=math.pi / 2 + 0.1, speed=0.5)
    assert bool(race.step(torch.zeros(1, 2)).terminated)
    place(race, s=1.0, speed=0.0)
    stopped = [bool(race.step(torch.tensor([[0.0, -1.0]])).terminated) for _ in range(25)]
    assert stopped.index(True) == pytest.approx(20, abs=1)


@pytest.mark.parametrize("poison", [float("nan"), float("inf")])
def test_a_nan_in_one_car_starts_it_over_and_reaches_nobody(poison, caplog):
    race, twin = make(cars=5), make(cars=5)
    race.state[4, 2] = poison
    with caplog.at_level(logging.WARNING):
        step = race.step(torch.zeros(5, 2))
    other = twin.step(torch.zeros(5, 2))
    assert step.faulty.tolist() == [False, False, True, False, False] and race.faults == 1
    assert "simulation failed" in caplog.text and "v_y" in caplog.text
    for table in (step.observation, step.reward, step.final_observation, race.state):
        assert torch.isfinite(table).all()
    assert float(step.reward[2]) == 0.0 and bool(step.terminated[2])
    healthy = [0, 1, 3, 4]
    assert torch.equal(step.observation[healthy], other.observation[healthy])


@pytest.mark.parametrize("waits", [True, False])
@pytest.mark.parametrize("what", ["state", "command", "place", "travelled", "action", "parameters"])
def test_nothing_absurd_reaches_a_policy_or_a_learner(what, waits, caplog):
    """NaN, infinities and absurd numbers in one car of four, anywhere: 12 × 1,000 of them."""
    race = make("dr=all_0.05", cars=4000)
    race.waits = waits
    draw = torch.Generator().manual_seed(0)
    poisons = torch.tensor([float("nan"), float("inf"), -float("inf"), 1e38, -1e38, 1e12])
    action = torch.zeros(4000, 2)
    for _ in range(3):  # on the way
        race.step(action)
    tables = {
        "state": race.state,
        "command": race.command,
        "place": race.place,
        "travelled": race.travelled[None],
        "action": action.T,
        "parameters": race.draws.values,
    }
    rows = torch.randint(len(tables[what]), (1000,), generator=draw)
    tables[what][rows, torch.arange(0, 4000, 4)] = poisons[torch.randint(6, (1000,), generator=draw)].to(
        tables[what].dtype
    )
    healthy = torch.ones(4000, dtype=torch.bool)
    healthy[::4] = False
    for step in (race.step(action), race.step(torch.zeros(4000, 2))):
        for table in (step.observation, step.final_observation, step.reward, step.progress, step.margin, race.state):
            assert torch.isfinite(table).all()
        assert step.final_observation.abs().max() <= OBSERVATION_LIMIT and step.reward.abs().max() < race.track.length
        assert not step.faulty[healthy].any()


def test_a_race_that_does_not_wait_is_the_same_race():
    """As on a GPU: cars start over by mask, and the device is not asked which."""
    overrides = ("dr=friction_0.02", "+vehicle/effect=[pose_latency,steering_delay]", "sim.max_steps=40")
    usual, blind = (make(*overrides, cars=64) for _ in range(2))
    blind.waits = False
    first = torch.ones(64, dtype=torch.bool)  # cars in their first episode: later ones have other dice
    generator = torch.Generator().manual_seed(0)
    for _ in range(60):
        action = torch.rand(64, 2, generator=generator) * 2 - 1
        expected = usual.step(action)
        with nothing_waits():
            got = blind.step(action)
        over = got.terminated | got.truncated
        for name in ("final_observation", "reward", "terminated", "truncated", "margin", "progress"):
            assert torch.equal(getattr(got, name)[first], getattr(expected, name)[first])
        assert torch.equal(got.observation[~over], got.final_observation[~over])
        assert torch.equal(got.observation[over], blind.observe()[over])
        assert (blind.age[over] == 0).all() and (blind.n[over].abs() < 1e-4).all()
        assert (blind.age[~over] > 0).all()
        first &= ~over
    assert not first.any() and len(blind.draws.values.unique()) == 64


@pytest.mark.gpu
def test_no_step_waits_for_a_gpu():
    race = make(
        "dr=friction_0.02",
        "+vehicle/effect=[pose_latency,steering_delay]",
        "sim.max_steps=10",
        cars=64,
        device=torch.device("cuda"),
    )
    actions = torch.rand(30, 64, 2, device=race.device) * 2 - 1
    for action in actions[:15]:  # constants come to the device once
        race.step(action)
    torch.cuda.set_sync_debug_mode("error")
    try:
        for action in actions[15:]:
            race.step(action)
    finally:
        torch.cuda.set_sync_debug_mode("default")
    assert race.faults == 0 and bool((race.age < 10).all())


def test_a_race_that_does_not_wait_starts_a_faulty_car_over():
    race = make(cars=5)
    race.waits = False
    race.state[4, 2] = float("nan")
    with nothing_waits():
        step = race.step(torch.zeros(5, 2))
    assert step.faulty.tolist() == [False, False, True, False, False] and race.faults == 1
    assert torch.isfinite(race.state).all() and torch.isfinite(step.observation).all()


def test_nan_actions_are_no_actions():
    race, twin = make(), make()
    a = race.step(torch.full((8, 2), float("nan")))
    b = twin.step(torch.zeros(8, 2))
    assert torch.equal(a.observation, b.observation)


def test_the_same_seed_gives_the_same_race():
    actions = torch.rand(50, 8, 2) * 2 - 1
    races = [make("dr=all_0.1", seeds=[seed]) for seed in (1, 1, 2)]
    tracks = [torch.stack([race.step(action).observation for action in actions]) for race in races]
    assert torch.equal(tracks[0], tracks[1]) and not torch.equal(tracks[0], tracks[2])


def test_with_a_seed_each_a_car_does_not_depend_on_its_neighbours():
    """The second car drives the same race alone, although its neighbour keeps crashing."""
    actions = torch.rand(100, 2, 2) * 2 - 1
    both, alone = make("dr=friction_0.1", cars=2, seeds=[5, 7]), make("dr=friction_0.1", cars=1, seeds=[7])
    for action in actions:
        together, single = both.step(action), alone.step(action[1:])
        assert torch.allclose(together.observation[1], single.observation[0], atol=1e-6)


def test_a_snapshot_continues_bit_for_bit():
    race, other = make("dr=all_0.05", seeds=[3]), make("dr=all_0.05", seeds=[4])
    actions = torch.rand(60, 8, 2) * 2 - 1
    for action in actions[:30]:
        race.step(action)
    other.restore({name: value.clone() for name, value in race.snapshot().items()})
    for action in actions[30:]:
        assert torch.equal(race.step(action).observation, other.step(action).observation)


def test_wheel_speed_rate_is_integrated_and_clamped():
    race = make(cars=1)
    place(race, s=0.5, speed=1.0)
    race.step(torch.tensor([[0.5, 1.0]]))
    assert race.command[:, 0].tolist() == pytest.approx([0.25, 1.25])
    place(race, s=0.5, speed=0.1)
    race.step(torch.tensor([[-9.0, -9.0]]))
    assert race.command[:, 0].tolist() == pytest.approx([-0.5, 0.01])


def test_wheel_speed_is_set_directly_in_the_other_action():
    race = make("action=speed", cars=1)
    place(race, s=0.5, speed=1.0)
    race.step(torch.tensor([[0.0, 1.0]]))
    assert float(race.command[1]) == pytest.approx(7.0) and float(race.command_rate) == pytest.approx(6.0 / 0.05)
    race.step(torch.tensor([[0.0, -1.0]]))
    assert float(race.command[1]) == pytest.approx(0.01)


def test_the_two_drive_modes_do_not_mix():
    with pytest.raises(ConfigError, match="motor_current"):
        make("action=current")
    race = make("action=current", "sim=motor_current", cars=1)
    place(race, s=0.5, speed=1.0)
    for _ in range(5):
        race.step(torch.tensor([[0.0, 0.5]]))
    assert float(race.v_x) > 1.3


@pytest.mark.parametrize(
    "change, said",
    [
        ({"dt": 0.05, "step": 0.03}, "multiple"),
        ({"dt": 0.0}, "dt"),
        ({"max_steps": 0}, "max_steps"),
        ({"step": 0.1}, "step"),
    ],
)
def test_timing_is_checked(change, said):
    with pytest.raises(ConfigError, match=said):
        dataclasses.replace(Timing(), **change)


def test_counts_are_checked():
    with pytest.raises(ConfigError, match="at least 1"):
        make(cars=0)
    with pytest.raises(ConfigError, match="seeds"):
        make(cars=3, seeds=[1, 2])
