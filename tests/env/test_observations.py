"""What the policy sees, number by number."""

import dataclasses

import pytest
import torch

from racerl import registry
from racerl.env import actions, observations
from racerl.env.chosen import Numbered
from racerl.errors import ConfigError
from racerl.vehicle.parameter import values
from tests.env.test_race import make, place


def test_geometric_lists_car_and_preview():
    race = make(cars=1)
    place(race, s=11.0, n=0.2, speed=3.0, heading=0.1)
    seen = race.observe()[0]
    assert seen.shape == (50,)
    assert seen[:5].tolist() == pytest.approx([0.5, 0.0, 0.1 / torch.pi, 0.4, 0.0], abs=1e-4)
    assert seen[5:10].tolist() == pytest.approx([0.0, 0.0, 0.0, 3.0 / 7.0, 0.5], abs=1e-6)
    ahead = 11.0 + 0.3 * torch.arange(1, 21)
    assert torch.allclose(
        seen[10:30] * race.track.max_curvature, race.frame.lookup(ahead, race.frame.curvature)[0], atol=1e-4
    )
    assert torch.allclose(seen[30:], torch.ones(20))


def test_progress_ends_with_the_place():
    race = make("obs=progress", cars=1)
    place(race, s=4.0, n=-0.1, speed=3.0)
    seen = race.observe()[0]
    assert seen.shape == (11,)
    assert seen.tolist()[:3] == pytest.approx([-0.2, 0.0, 0.5], abs=1e-4)
    assert float(seen[-1]) == pytest.approx(4.0 / race.track.length, abs=1e-4)


def looking_back(race, car=0):
    """Return what a car sees of the steps before, in units (steps, 7), the latest first."""
    maxima = torch.tensor([seen.maximum for seen in race.observation.sees(race.action)])
    return (race.observe()[car] * maxima)[50:].reshape(-1, 7)


def test_history_shows_what_the_car_did_and_what_it_was_told():
    race = make("obs=history", "obs.steps=3", cars=2)
    assert race.observe().shape == (2, 71)
    place(race, s=4.0, speed=2.0)
    gone = []
    for number in range(5):
        before = race.state[:, 0].clone()
        race.step(torch.full((2, 2), 0.2 * number - 0.4))
        gone.insert(0, [*before[[3, 4, 5, 6, 7]].tolist(), *race.command[:, 0].tolist()])
    torch.testing.assert_close(looking_back(race), torch.tensor(gone[:3]), rtol=1e-5, atol=1e-5)
    plain = make(cars=2)
    plain.state, plain.place, plain.command, plain.command_rate = (
        race.state,
        race.place,
        race.command,
        race.command_rate,
    )
    assert torch.equal(race.observe()[:, :50], plain.observe())


def test_a_car_that_starts_over_remembers_nothing_of_the_one_before():
    race = make("obs=history", "obs.steps=4", cars=2)
    for _ in range(3):
        race.step(torch.tensor([[0.3, 0.5], [-0.4, 0.2]]))
    other = looking_back(race, car=1)
    race.restart(torch.tensor([True, False]))
    start = torch.tensor([*race.state[[3, 4, 5, 6, 7], 0].tolist(), *race.command[:, 0].tolist()])
    torch.testing.assert_close(looking_back(race), start.expand(4, -1))
    assert torch.equal(looking_back(race, car=1), other)


def test_history_remembers_what_the_sensors_showed():
    race = make("obs=history", "obs.steps=2", "+dr.estimate={v_x: 0.5}", cars=1)
    race.step(torch.zeros(1, 2))
    shown = race.observe()[0, 0] * 6.0
    assert abs(shown - race.state[3, 0]) > 1e-3
    race.step(torch.zeros(1, 2))
    assert looking_back(race)[0, 0] == pytest.approx(float(shown), abs=1e-5)


def test_geometric_does_not_depend_on_the_place_of_an_equal_track():
    """A car sees the same on two stretches with the same curvature: here, on a circle."""
    race = make(cars=2)
    place(race, s=3.0, speed=2.0)
    race.frame.curvature = torch.full_like(race.frame.curvature, 0.3)
    race.place[0] = torch.tensor([3.0, 9.0])
    seen = race.observe()
    assert torch.equal(seen[0], seen[1])


def test_a_policy_sees_another_track_in_the_scale_it_was_trained_with():
    home = make(cars=1)
    kept = dataclasses.asdict(home.observation)
    assert kept["curvature_max"] == home.track.max_curvature and kept["width_max"] == 0.5
    elsewhere = dataclasses.replace(home.track, curvature=home.track.curvature / 2)
    fresh = type(home.observation)().fitted(elsewhere)
    assert fresh.curvature_max == pytest.approx(kept["curvature_max"] / 2)
    assert type(home.observation)(**kept).fitted(elsewhere) == home.observation


@pytest.mark.parametrize("package", [observations, actions])
def test_every_module_is_found_and_builds(package):
    names = registry.choices(package)
    assert len(names) >= 2
    for name in names:
        assert registry.create(package, {"name": name}) is not None


@pytest.mark.parametrize(
    "settings, said",
    [
        ({"name": "geometrc"}, "geometric"),
        ({}, "name"),
        ({"name": "geometric", "point": 3}, "points"),
        ({"name": "geometric", "points": 0}, "points"),
        ({"name": "os.system"}, "unknown"),
        ({"name": 3}, "unknown"),
        ({"name": "geometric", "points": "many"}, "obs.points = many"),
        ({"name": "geometric", "points": 20.5}, "obs.points = 20.5"),
        ({"name": "geometric", "spacing": True}, "obs.spacing = True"),
        ({"name": "geometric", "curvature_max": -1}, "curvature_max"),
        ({"name": "progress", "length": "far"}, "length"),
        ({"name": "history", "steps": 0}, "steps"),
        ({"name": "history", "steps": 2.5}, "steps"),
    ],
)
def test_wrong_settings_are_named(settings, said):
    with pytest.raises(ConfigError, match=said):
        registry.create(observations, settings)


def test_privileged_tells_by_how_much_the_car_differs_from_its_model():
    race = make("obs=privileged", "dr=all_0.1", "dr.sigma=0.2", cars=3)
    names, own = race.observation.parameters, dict(zip(race.draws.names, race.draws.values, strict=True))
    assert set(names) == set(own) and race.observe().shape == (3, 50 + len(names))
    nominal = values(race.vehicle)
    expected = torch.stack([10 * (own[name] / nominal[name] - 1) for name in names], dim=1)
    torch.testing.assert_close(race.observe()[:, 50:], expected)
    assert expected.abs().max() > 1  # the cars do differ
    told = race.observe()
    race.restart(torch.tensor([False, True, False]))
    again = race.observe()
    assert torch.equal(again[[0, 2], 50:], told[[0, 2], 50:]) and not torch.equal(again[1, 50:], told[1, 50:])


def test_privileged_tells_a_single_car_the_same_as_beside_others():
    race = make("obs=privileged", "dr=all_0.1", cars=3)
    one = race.observe(Numbered(torch.tensor([2])))
    torch.testing.assert_close(one, race.observe()[2:])


def test_privileged_tells_nothing_of_a_car_that_is_as_modelled():
    race = make("obs=privileged", cars=2)
    assert torch.equal(race.observe()[:, 50:], torch.zeros(2, 18))
    with pytest.raises(ConfigError, match="no 'grip'"):
        make("obs=privileged", "obs.parameters=[grip]").observe()
    with pytest.raises(ConfigError, match="parameters = "):
        make("obs=privileged", "obs.parameters=[]")


@pytest.mark.parametrize("limit", [{"drive_max": "abc"}, {"rate_max": 0}, {"steering_max": -0.5}])
@pytest.mark.parametrize("name", registry.choices(actions))
def test_limits_that_no_car_has_are_refused(name, limit):
    with pytest.raises(ConfigError, match=f"action.{next(iter(limit))} = "):
        registry.create(actions, {"name": name, **limit})
