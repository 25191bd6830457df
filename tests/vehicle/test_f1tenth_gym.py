"""The car of F1TENTH's gym: driven by the gym's own equations where it is installed, missed in one line elsewhere."""

import importlib.util
import math

import pytest

from racerl.assemble import Car
from racerl.config import compose_settings
from racerl.errors import VehicleError
from racerl.vehicle.bodies.f1tenth_gym import F1tenthGym
from racerl.vehicle.load import load_vehicle
from tests.vehicle.test_bodies import driven

THERE = importlib.util.find_spec("f110_gym") is not None
gym = pytest.mark.skipif(not THERE, reason="needs the equations of F1TENTH's gym, which is in no package index")


def vehicle():
    asked = compose_settings("evaluate", ["run=x", "car=f1tenth_gym", "vehicle=published"])
    return load_vehicle(Car(**asked["car"]).wear(asked["vehicle"]))


@pytest.mark.skipif(THERE, reason="F1TENTH's gym is installed")
def test_without_the_gym_it_says_where_to_get_it():
    with pytest.raises(VehicleError, match=r"pip install --no-deps 'git\+https://github.com/f1tenth/f1tenth_gym'"):
        F1tenthGym(vehicle())


@gym
def test_it_turns_as_its_cornering_stiffness_has_it():
    """δ = L κ + K a_y, K = (1/C_Sf − 1/C_Sr)/(μ g), on average: its steering hunts about where it should be."""
    car = vehicle()
    rows = driven(F1tenthGym(car), [(0.1, 2.0)] * 800, 0.01, [0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 2.0])[-400:]
    speed, yaw_rate, delta = math.hypot(*rows[:, 3:5].mean(axis=0)), rows[:, 5].mean(), rows[:, 6].mean()
    understeer = (1.0 / 4.718 - 1.0 / 5.4562) / (1.0489 * 9.81)
    assert speed == pytest.approx(2.0, abs=0.01) and delta == pytest.approx(0.1, abs=0.02)
    assert float(car.wheelbase) * yaw_rate / speed + understeer * yaw_rate * speed == pytest.approx(delta, rel=0.005)


@gym
def test_its_steering_is_two_steps_late_and_steps_shorter_than_its_own_wait():
    start = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
    rows = driven(F1tenthGym(vehicle()), [(0.2, 1.0)] * 4, 0.01, start)
    assert rows[:2, 6] == pytest.approx(0.0) and rows[2:, 6] == pytest.approx([0.032, 0.064])
    halves = driven(F1tenthGym(vehicle()), [(0.2, 1.0)] * 8, 0.005, start)
    assert halves[1::2] == pytest.approx(rows)


@gym
def test_it_rolls_backwards_as_it_began():
    rows = driven(F1tenthGym(vehicle()), [(0.0, -0.2)] * 20, 0.01, [0.0, 0.0, 0.0, -0.2, 0.0, 0.0, 0.0, -0.2])
    assert rows[-1, 0] == pytest.approx(-0.04, abs=1e-3) and rows[-1, 3] == pytest.approx(-0.2, abs=1e-3)


def test_it_is_told_speeds_and_no_currents():
    asked = compose_settings("evaluate", ["run=x", "car=f1tenth_gym", "vehicle=published", "sim=motor_current"])
    car = load_vehicle(Car(**asked["car"]).wear(asked["vehicle"]), drive=asked["sim"]["drive"])
    with pytest.raises(VehicleError, match="sim=default"):
        F1tenthGym(car)
