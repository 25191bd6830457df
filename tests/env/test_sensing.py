"""A policy sees what the car's sensors show: wrong by what they are wrong, late by what they are late."""

import pytest
import torch

from racerl.assemble import build_race
from racerl.config import compose_settings
from racerl.env.chosen import Numbered
from racerl.env.race import DELTA, OMEGA, V_X, YAW_RATE, View, X

CARS = 5


def race_with(**effects):
    words = [f"+vehicle/effect=[{','.join(effects)}]"] if effects else []
    words += [f"vehicle.effects.{name}.{key}={value}" for name, e in effects.items() for key, value in e.items()]
    return build_race(compose_settings("train", words), cars=CARS, seeds=[3])


def driven(race, steps):
    """Drive by random actions; return true states after each step, (steps + 1, S, N)."""
    generator = torch.Generator().manual_seed(0)
    states = [race.state.clone()]
    for _ in range(steps):
        assert not race.step(torch.rand(CARS, 2, generator=generator) - 0.3).terminated.any()
        states.append(race.state.clone())
    return torch.stack(states)


def test_honest_sensors_cost_nothing():
    race = race_with()
    assert len(race.shown) == 0 and View.of(race, None).state is race.state


def test_the_truth_stays_and_the_observation_differs():
    plain, flawed = race_with(), race_with(steering_sensor_offset={"offset": 0.05}, wheel_speed_gain={"gain": 1.1})
    before, after = driven(plain, 6), driven(flawed, 6)
    assert torch.equal(before, after[:, : before.shape[1]])
    view = View.of(flawed, None)
    assert torch.allclose(view.delta, flawed.delta + 0.05) and torch.allclose(view.omega, 1.1 * flawed.omega)
    assert torch.equal(view.v_x, flawed.v_x) and not torch.equal(plain.observe(), flawed.observe())


@pytest.mark.parametrize(("latency", "whole", "share"), [(0.05, 1, 0.0), (0.02, 0, 0.4), (0.12, 2, 0.4)])
def test_a_late_channel_shows_what_was(latency, whole, share):
    race = race_with(pose_latency={"latency": latency})
    states = driven(race, 6)
    then = (1.0 - share) * states[-1 - whole] + share * states[-2 - whole]
    view = View.of(race, None)
    for row in (X, V_X, YAW_RATE):
        assert torch.allclose(view.state[row], then[row], atol=1e-6), row
    for row in (DELTA, OMEGA):  # on board, and in time
        assert torch.equal(view.state[row], states[-1][row])
    assert (view.s != race.s).all()


def test_a_new_episode_begins_without_the_last_ones_past():
    race = race_with(pose_latency={"latency": 0.1})
    driven(race, 4)
    race.put(torch.tensor([2]), race.state[:, 4:5].clone(), race.command[:, 4:5].clone())
    view = View.of(race, Numbered(torch.tensor([2])))
    assert torch.allclose(view.v_x, race.v_x[2]) and torch.allclose(view.s, race.s[2], atol=1e-4)
    assert not torch.allclose(View.of(race, None).v_x[3], race.v_x[3])


def test_a_snapshot_holds_what_was_shown():
    race, other = race_with(pose_latency={"latency": 0.1}), race_with(pose_latency={"latency": 0.1})
    driven(race, 4)
    other.restore(race.snapshot())
    assert torch.equal(other.observe(), race.observe())


def test_what_is_seen_carries_the_noise_that_was_asked_for():
    settings = compose_settings("train", [])
    race = build_race(settings, cars=2000, seeds=[3], noise={"v_x": 0.1, "yaw": 0.02})
    race.step(torch.zeros(2000, 2))
    error = race.seen()[0] - race.state[:8]
    assert float(error[V_X].std()) == pytest.approx(0.1, rel=0.1) and abs(float(error[V_X].mean())) < 0.01
    assert not error[DELTA].any() and float(error[2].std()) == pytest.approx(0.02, rel=0.1)
