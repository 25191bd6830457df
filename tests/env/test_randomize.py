"""Domain randomization: the right parameters, the right spread, inside the bounds."""

import numpy as np
import pytest
import torch

from racerl.errors import ConfigError
from racerl.vehicle.cars import write_cars
from racerl.vehicle.parameter import specifications, values
from tests.env.test_race import make


@pytest.mark.parametrize("choice, names", [("none", 0), ("friction_0.05", 1), ("all_0.05", 18)])
def test_parameters_spread_by_sigma(choice, names):
    race = make(f"dr={choice}", cars=20000)
    assert len(race.draws.names) == names
    nominal = values(race.vehicle)
    for name, drawn in zip(race.draws.names, race.draws.values, strict=True):
        factor = drawn / nominal[name]
        assert float(factor.mean()) == pytest.approx(1.0, abs=0.002), name
        assert float(factor.std()) == pytest.approx(0.05, rel=0.05), name


def test_all_names_what_the_paper_names():
    names = set(make("dr=all_0.02").draws.names)
    assert {"friction", "mass", "yaw_inertia", "l_f", "steering.time_constant", "drive.time_constant"} <= names
    assert {"front.p_Ky1", "rear.p_Kx1", "front.p_Cy1", "rear.p_Ey1"} <= names
    assert not any(".p_D" in name for name in names)  # friction already scales the peak


def test_any_sigma_by_override():
    race = make("dr=friction_0.02", "dr.sigma=0.2", cars=20000)
    assert float(race.draws.values[0].std()) == pytest.approx(0.2 * 0.8, rel=0.05)


def test_draws_stay_inside_the_bounds():
    race = make("dr=friction_0.02", "dr.sigma=1.0", cars=5000)
    bounds = specifications(race.vehicle)["friction"]
    drawn = race.draws.values[0]
    assert float(drawn.min()) >= bounds.low - 1e-7 and float(drawn.max()) <= bounds.high
    assert (drawn <= bounds.low + 1e-6).any()


def test_only_cars_that_start_over_are_drawn_anew():
    race = make("dr=friction_0.1", cars=6)
    before = race.draws.values.clone()
    race.restart(torch.tensor([True, False, False, True, False, False]))
    changed = (race.draws.values != before).any(dim=0)
    assert changed.tolist() == [True, False, False, True, False, False]


def test_randomized_friction_changes_the_drive():
    race = make("dr=friction_0.1", cars=50)
    race.state = race.state[:, :1].expand(-1, 50).clone()
    race.state[3], race.state[7] = 3.0, 3.0
    for _ in range(4):
        moved = race.motion(race.state, torch.tensor([[0.4], [3.0]]).expand(2, 50), race.draws.values)
        race.state = moved
    order = race.draws.values[0].argsort()
    assert (race.state[5][order].diff() >= -1e-5).all()  # more friction, more yaw rate


def test_cars_of_a_run_are_drawn_whole_and_what_else_is_chosen_is_multiplied_on_top(tmp_path):
    vehicle = make("vehicle=published").vehicle
    inertia, stiffness = float(vehicle.yaw_inertia), float(vehicle.front.p_Ky1)
    shares = np.linspace(-0.1, 0.1, 21)
    cars = np.stack([inertia * (1.0 + shares), stiffness * (1.0 - shares)], axis=1)
    write_cars(tmp_path, vehicle, ("yaw_inertia", "front.p_Ky1"), cars)
    words = ["vehicle=published", f"dr=posterior:{tmp_path}"]
    race = make(*words, cars=5000)
    drawn = (race.draws.values / torch.tensor([[inertia], [stiffness]])).double()
    assert race.draws.names == ["yaw_inertia", "front.p_Ky1"]
    assert torch.allclose(drawn.sum(dim=0), torch.tensor(2.0, dtype=torch.float64), atol=1e-6)  # correlated by −1
    assert len(drawn[0].unique()) == 21 and float(drawn[0].std()) == pytest.approx(shares.std(), rel=0.05)
    both = make(*words, "dr.sigma=0.05", "dr.parameters=[friction,yaw_inertia]", cars=5000)
    factor = both.draws.values / torch.tensor([[inertia], [stiffness], [float(vehicle.friction)]])
    assert both.draws.names == ["yaw_inertia", "front.p_Ky1", "friction"]
    expected = [np.hypot(shares.std(), 0.05), shares.std(), 0.05]
    assert factor.std(dim=1).tolist() == pytest.approx(expected, rel=0.05)
    told = both.privileged()  # standard deviations from the middle of all
    assert told.shape == (5000, 3) and told.mean(dim=0).abs().max() < 0.05
    assert told.std(dim=0).tolist() == pytest.approx([1.0, 1.0, 1.0], rel=0.05)


def test_of_cars_that_are_all_alike_a_critic_is_told_nothing_absurd(tmp_path):
    vehicle = make("vehicle=published").vehicle
    inertia = float(vehicle.yaw_inertia) * (1.0 + 5e-5)  # as a file may round
    write_cars(tmp_path, vehicle, ("yaw_inertia",), np.full((9, 1), inertia))
    race = make("vehicle=published", f"dr=posterior:{tmp_path}", cars=50)
    assert race.privileged().abs().max() < 0.01


def test_noise_is_on_what_is_seen_and_what_is_done():
    race = make("dr=friction_0.02_noise", "dr.actions=0.1", cars=4000)
    race.step(torch.zeros(4000, 2))
    assert float(race.command[0].std()) == pytest.approx(0.1 * race.action.steering_max, rel=0.1)
    error = race.seen()[0] - race.state[:8]
    assert float(error[4].std()) == pytest.approx(0.018, rel=0.1)
    exact = make("dr=friction_0.02", cars=10)
    exact.step(torch.zeros(10, 2))
    assert not exact.command[0].any() and exact.seen()[0] is exact.state


@pytest.mark.parametrize(
    "override, said",
    [
        ("dr.parameters=[fricton]", "friction"),
        ("dr.actions=-0.1", "dr.actions"),
        ("dr.estimate.v_z=0.1", "did you mean"),
        ("dr.estimate.v_y=-0.1", "dr.estimate.v_y"),
        ("dr.estimate=0.1", "mapping"),
        ("dr.sigma=2", "0 … 1"),
        ("dr.sigma=-0.1", "0 … 1"),
    ],
)
def test_wrong_randomization_is_refused(override, said):
    with pytest.raises(ConfigError, match=said):
        make("dr=friction_0.02", override)


def test_a_spread_of_nothing_is_refused():
    with pytest.raises(ConfigError, match=r"no parameter is to spread.*dr=friction_0.02 dr.sigma=0.03"):
        make("dr.sigma=0.03")


def test_a_misspelt_parameter_is_refused_though_nothing_is_spread():
    with pytest.raises(ConfigError, match="did you mean friction"):
        make("dr=friction_0.02", "dr.sigma=0", "dr.parameters=[fricton]")


@pytest.mark.parametrize("each_lap", [False, True])
def test_a_car_may_change_from_lap_to_lap(each_lap):
    race = make("dr=friction_0.1", f"+dr.each_lap={each_lap}", cars=4)
    race.travelled = torch.tensor([0.5, 1.0, 2.0, 3.0], dtype=torch.float64) * race.track.length - 0.001
    race.travelled[0] = 1.0
    before = race.draws.values.clone()
    race.step(torch.zeros(4, 2))  # all but the first cross the line
    changed = (race.draws.values != before).any(dim=0)
    assert changed.tolist() == [False, each_lap, each_lap, each_lap]
