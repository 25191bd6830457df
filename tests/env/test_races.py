"""Cars on several tracks as one race, and a policy that learns on them."""

from dataclasses import asdict
from functools import cache

import pytest
import torch

from racerl.assemble import build_race, build_races
from racerl.config import compose_settings
from racerl.env.races import SEED_STEP, Races
from racerl.errors import ConfigError
from racerl.evaluate.evaluate import evaluate
from racerl.train.train import train
from tests.train.short import refinement

CPU = torch.device("cpu")
TRACKS = "track=[l_shape,oval,hairpin]"
SMOKE = ["budget=smoke", "threads=1", "budget.steps=1024"]


@cache
def settings(*words):
    return compose_settings("train", words)


def make(*words, cars=8, seed=0, times=1):
    return build_races(settings(TRACKS, *words), cars=cars, seed=seed, device=CPU, times=times)


def driven(race, steps, seed=0):
    """Return what comes of random actions."""
    dice = torch.Generator().manual_seed(seed)
    return [race.step(2.0 * torch.rand(race.count, 2, generator=dice) - 1.0) for _ in range(steps)]


def test_a_single_track_is_the_race_that_it_was():
    ours = build_races(settings("+dr=friction_0.02"), cars=6, seed=3, device=CPU)
    plain = build_race(settings("+dr=friction_0.02"), cars=6, seeds=[3], device=CPU)
    assert not isinstance(ours, Races)
    for a, b in zip(driven(ours, 40), driven(plain, 40), strict=True):
        assert all(torch.equal(*pair) for pair in zip(a, b, strict=True))


def test_cars_are_spread_evenly_in_the_tracks_order():
    race = make(cars=8)
    assert [each.track.name for each in race.races] == ["l_shape", "oval", "hairpin"]
    assert race.counts == [3, 3, 2] and race.count == 8 and race.observe().shape == (8, 50)
    with pytest.raises(ConfigError, match="2 cars for 3 tracks"):
        make(cars=2)


def test_every_car_drives_as_in_a_race_of_its_own():
    words = ["+dr=friction_0.02", "dr.sigma=0.1", "sim.max_steps=30"]
    race = make(*words, cars=9, seed=5)
    seen = {"name": "geometric", **asdict(race.observation)}
    alone = [
        build_race({**settings(*words), "track": {"file": f"{name}.csv"}, "obs": seen}, cars=3, seeds=[seed])
        for name, seed in (("l_shape", 5), ("oval", 5 + SEED_STEP), ("hairpin", 5 + 2 * SEED_STEP))
    ]
    dice = torch.Generator().manual_seed(1)
    ended = 0
    for _ in range(80):
        action = 2.0 * torch.rand(9, 2, generator=dice) - 1.0
        step = race.step(action)
        parts = [each.step(own) for each, own in zip(alone, action.split(3), strict=True)]
        for name in ("observation", "reward", "terminated", "truncated", "final_observation", "progress", "margin"):
            assert torch.equal(getattr(step, name), torch.cat([getattr(part, name) for part in parts])), name
        assert torch.equal(step.command, torch.cat([part.command for part in parts], dim=1))
        ended += int((step.terminated | step.truncated).sum())
    assert ended >= 18  # the episodes' ends were driven through, too


def test_all_tracks_are_seen_in_one_scale():
    race = make()
    assert race.observation.curvature_max == max(each.track.max_curvature for each in race.races)
    assert race.observation.width_max == max(each.track.max_half_width for each in race.races)
    assert {each.observation for each in race.races} == {race.observation}


def test_a_snapshot_goes_on_bit_for_bit():
    words = ["+dr=friction_0.02", "sim.max_steps=20", "obs=history"]
    race, other = make(*words, seed=1), make(*words, seed=2)
    driven(race, 15)
    other.restore({name: tensor.clone() for name, tensor in race.snapshot().items()})
    for a, b in zip(driven(race, 40, seed=7), driven(other, 40, seed=7), strict=True):
        assert all(torch.equal(*pair) for pair in zip(a, b, strict=True))


def test_all_that_a_privileged_critic_is_told_is_in_the_order_of_the_cars():
    race = make("+dr=friction_0.02")
    told = race.privileged()
    assert told.shape == (8, 1) and len(told.unique()) == 8
    friction = torch.cat([each.draws.values for each in race.races], dim=-1)[0]
    torch.testing.assert_close(told[:, 0], (friction / 0.8 - 1.0) / 0.02, rtol=1e-3, atol=1e-3)


def test_cars_are_put_and_started_over_by_their_numbers():
    race = make(cars=8)
    driven(race, 10)
    before, kept = race.state.clone(), race.age.clone()
    cars = torch.tensor([7, 1, 4])  # on the third track, the first and the second
    state = before[:, cars] + torch.tensor([0.0, 0.0, 0.0, 0.5, 0, 0, 0, 0.5])[:, None]
    race.put(cars, state, race.command[:, cars])
    rest = torch.tensor([0, 2, 3, 5, 6])
    assert torch.equal(race.state[:, cars], state) and torch.equal(race.state[:, rest], before[:, rest])
    assert (race.age[cars] == 0).all() and torch.equal(race.age[rest], kept[rest])
    race.restart(torch.arange(8) == 5)
    assert int(race.age[5]) == 0 and not torch.equal(race.state[:, 5], before[:, 5])
    assert torch.equal(race.state[:, [0, 2, 3, 6]], before[:, [0, 2, 3, 6]])
    race.age = torch.arange(8)
    assert [each.age.tolist() for each in race.races] == [[0, 1, 2], [3, 4, 5], [6, 7]]


def test_the_second_of_a_pair_is_on_the_track_of_the_first():
    race = make(cars=8, times=2)
    names = [name for each in race.races for name in [each.track.name] * each.count]
    assert race.count == 16 and names[:8] == names[8:]


def test_a_policy_learns_on_several_tracks_and_is_raced_on_another(tmp_path):
    facts = train(settings("track=[oval,bean]", *SMOKE, refinement(), "+dr=friction_0.02"), tmp_path / "run")
    # eight cars on each of the tracks, two laps each
    assert facts["best"]["laps"] == 2 * 8 * 2 and facts["refined"] == 2
    for words, track in ((["track=l_shape"], "l_shape"), ([], "oval")):
        raced = compose_settings("evaluate", [*words, "laps=1", "seeds=[0]"], {"run": [str(tmp_path / "run")]})
        assert evaluate(raced, tmp_path / track)["track"] == track


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["obs=progress"], "obs=progress sees its place on one track"),
        (["algo=imitation"], "algo=imitation learns on one track"),
    ],
)
def test_what_is_of_one_track_is_refused(words, told, tmp_path):
    with pytest.raises(ConfigError, match=told):
        train(settings(TRACKS, *SMOKE, *words), tmp_path / "run")
    assert not (tmp_path / "run").exists()
