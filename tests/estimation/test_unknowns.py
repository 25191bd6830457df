"""Priors: which parameters are free, how firmly they are known, and what is refused."""

import numpy as np
import pytest

from racerl.errors import ConfigError
from racerl.estimation.unknowns import choose_unknowns
from racerl.vehicle.rollout import drive_by
from tests.vehicle.conftest import make_car

CAR = make_car()


def choose(priors, hold=(), car=CAR):
    return choose_unknowns(car, priors, hold, CAR)


def test_shares_absolutes_and_null():
    unknowns = choose({"mass": None, "l_f": 0.1, "*.p_E[xy]1": {"absolute": 2.0}, "front.p_Ex1": 0.5, "yaw_inertia": 0})
    expected = {"l_f": 0.1 * CAR.l_f, "front.p_Ex1": 0.5 * abs(CAR.front.p_Ex1), "front.p_Ey1": 2.0}
    assert {name: unknowns.sigma[unknowns.names.index(name)] for name in expected} == pytest.approx(expected)
    assert "mass" not in unknowns.names and "yaw_inertia" not in unknowns.names


def test_dotted_overrides_nest_and_mean_the_same():
    nested = choose({"l_f": 0.1, "front": {"p_Hy1": {"absolute": 0.02}, "p_Ky1": 0.3}})
    assert nested.names == choose({"l_f": 0.1, "front.p_Hy1": {"absolute": 0.02}, "front.p_Ky1": 0.3}).names
    assert nested.sigma[nested.names.index("front.p_Hy1")] == 0.02


def test_hold_takes_back():
    names = choose({"l_f": 0.1, "*.p_K[xy]1": 0.3}, ["front.*"]).names
    assert set(names) == {"l_f", "rear.p_Kx1", "rear.p_Ky1"}


def test_actuators_that_are_inputs_have_no_parameters():
    driven = drive_by(CAR, measured_steering=True, measured_speed=False)
    assert choose({"*.time_constant": 0.5}, car=driven).names == ("drive.time_constant",)


def test_an_effect_brings_its_parameters():
    car = make_car("+vehicle/effect=tyre_relaxation")
    assert choose_unknowns(car, {"effects.*": 0.5}, [], car).names == ("effects.tyre_relaxation.length",)
    assert choose({"effects.*": 0.5, "l_f": 0.1}).names == ("l_f",)


def test_draws_respect_the_bounds():
    unknowns = choose({"front.r_Ex1": {"absolute": 100.0}})
    draws = np.array([unknowns.draw(np.random.default_rng(seed), 1.0)[0] for seed in range(50)])
    assert draws.min() >= -20.0 and draws.max() <= 1.0 and draws.std() > 1.0


@pytest.mark.parametrize(
    "priors, hold, said",
    [
        ({"yaw_inertai": 0.2}, [], "did you mean yaw_inertia"),
        ({"l_f": 0.1}, ["frnt.*"], "no parameter of the vehicle fits 'frnt"),
        ({"l_f": "much"}, [], "priors.l_f = much"),
        ({"l_f": -0.1}, [], "priors.l_f"),
        ({"l_f": {"absolut": 1}}, [], "no parameter of the vehicle fits .l_f.absolut."),
        ({"l_f": None}, [], "every parameter is held"),
        ({"l_f": {"share": 0.1, "within": [1.0]}}, [], "within: .low, high."),
        ({"l_f": {"share": 0.1, "within": [0.3, 0.1]}}, [], "within: .low, high."),
        ({"l_f": {"share": 0.1, "width": 3}}, [], "priors.l_f"),
    ],
)
def test_mistakes(priors, hold, said):
    with pytest.raises(ConfigError, match=said) as error:
        choose(priors, hold)
    assert "\n" not in str(error.value)


def test_a_range_keeps_the_fit_inside_but_not_the_vehicle():
    unknowns = choose({"*.p_Cy1": {"share": 0.3, "within": [0.5, 2.0]}, "*.p_Ex1": {"absolute": 1, "within": [-2, 9]}})
    bounds = {name: (low, high) for name, low, high in zip(unknowns.names, unknowns.low, unknowns.high, strict=True)}
    assert bounds["front.p_Cy1"] == (0.5, 2.0)
    assert bounds["rear.p_Ex1"] == (min(-2.0, CAR.rear.p_Ex1), 1.0)  # no higher than a vehicle's own bound
    assert unknowns.sigma[unknowns.names.index("front.p_Cy1")] == pytest.approx(0.3 * CAR.front.p_Cy1)
    outside = choose({"l_f": {"share": 0.1, "within": [0.2, 0.3]}})
    assert outside.low[0] == pytest.approx(CAR.l_f) and outside.high[0] == 0.3


@pytest.mark.parametrize(
    "priors, hold, said",
    [
        ({"yaw_inertia": 0.2}, ["*"], "every parameter is held; leave some out of hold"),
        ({"yaw_inertia": None}, [], "every parameter is held; free some in priors"),
        ({"l_f": {"within": [0.1, 0.2]}}, [], "priors.l_f = .* allowed is a share"),
    ],
)
def test_what_frees_nothing_says_why(priors, hold, said):
    with pytest.raises(ConfigError, match=said):
        choose(priors, hold)
