"""A car whose simulation fails leaves its last steps, and they can be driven again to the same failure."""

import pandas as pd
import pytest
import torch

from racerl.assemble import build_race
from racerl.config import compose_settings
from racerl.env.black_box import FILE, LENGTH, MOST, read_failures, replay, write_failures
from racerl.env.race import LARGEST, YAW
from racerl.errors import RunError

WORDS = {
    "plain": [],
    "randomized": ["+dr=all_0.05"],
    "late": ["+vehicle/effect=[steering_delay,drive_delay]"],
    "with states of its own": ["+vehicle/effect=roll_dynamics"],
}


def spun(words, turn, cars=8, broken=(3,)):
    """Return a race in which some cars have turned by so much, beyond what is taken for a state, and its settings."""
    settings = compose_settings("train", words)
    race = build_race(settings, cars=cars, seeds=[0], termination=lambda race: torch.zeros(cars, dtype=torch.bool))
    numbers = torch.tensor(broken)
    state = race.state[:, numbers].clone()
    state[YAW] = LARGEST - turn
    race.put(numbers, state, race.command[:, numbers])
    dice = torch.Generator().manual_seed(1)
    for _ in range(600):
        race.step(torch.stack([torch.ones(cars), torch.rand(cars, generator=dice) * 0.2 - 0.05], dim=1))
        if race.faults:
            return race, settings
    raise AssertionError("no car has failed")


@pytest.mark.parametrize("turn", [0.5, 10.0], ids=["a young episode", "an old one"])
@pytest.mark.parametrize("words", list(WORDS.values()), ids=list(WORDS))
def test_a_failure_can_be_driven_again(words, turn, tmp_path):
    race, settings = spun(words, turn)
    write_failures(tmp_path, [race])
    failure = pd.read_parquet(tmp_path / FILE)
    assert set(failure["car"]) == {3} and failure["step"].tolist() == list(range(1 - len(failure), 1))
    assert len(failure) == LENGTH if turn > 5 else 3 < len(failure) < LENGTH
    states = replay(build_race(settings, cars=1, seeds=[9]), failure)
    told = torch.as_tensor(failure[list(race.vehicle.states)].to_numpy())
    assert torch.equal(states[:-1], told[len(told) - len(states) + 1 :])
    assert bool((states[:-1].abs() < LARGEST).all()) and not bool((states[-1].abs() < LARGEST).all())  # fails again


def test_failures_of_before_an_interruption_stay(tmp_path):
    race, _ = spun([], 0.5)
    write_failures(tmp_path, [race])
    write_failures(tmp_path, [race], read_failures(tmp_path))
    one, other = read_failures(tmp_path)
    assert one.drop(columns="failure").equals(other.drop(columns="failure").set_axis(one.index))
    assert one["failure"].unique().tolist() == [0] and other["failure"].unique().tolist() == [1]


def test_one_too_short_for_commands_that_act_late_is_a_line():
    race, settings = spun(WORDS["late"], 10.0)
    with pytest.raises(RunError, match="act up to"):
        replay(build_race(settings, cars=1, seeds=[9]), race.box.failures[0].iloc[-1:])


def test_only_the_first_failures_are_kept():
    race, _ = spun([], 0.5, cars=2 * MOST, broken=range(2 * MOST))
    for _ in range(20):
        race.step(torch.ones(2 * MOST, 2) * torch.tensor([1.0, 0.05]))
    assert len(race.box.failures) == MOST < race.faults


def test_no_failure_leaves_no_file(tmp_path):
    race = build_race(compose_settings("train"), cars=2, seeds=[0])
    race.step(torch.zeros(2, 2))
    write_failures(tmp_path, [race])
    assert not list(tmp_path.iterdir())
