"""The integrator converges at its order, and its step is a limit of smaller ones."""

import numpy as np
import pytest
import torch

from racerl.vehicle.integrate import advance
from racerl.vehicle.ops import TORCH
from tests.vehicle.conftest import make_car


def drive(car, dt):
    """A quarter second of a smooth manoeuvre away from standstill."""
    state = torch.zeros(8, 1, dtype=torch.float64)
    state[3] = state[7] = 3.0
    command = torch.tensor([[0.2], [3.5]], dtype=torch.float64)
    return advance(car, state, command, dt, round(0.25 / dt), TORCH)


@pytest.fixture(scope="module")
def reference(car):
    return drive(car, 0.0003125)


def test_runge_kutta_is_of_fourth_order(car, reference):
    errors = [float((drive(car, dt) - reference).abs().max()) for dt in (0.01, 0.005, 0.0025)]
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    assert (orders > 3.6).all(), errors


def test_the_step_of_10_ms_is_fine_enough(car, reference):
    assert float((drive(car, 0.01) - reference).abs().max()) < 1e-5


def test_halves_make_a_whole(car):
    state = torch.zeros(8, 1, dtype=torch.float64)
    state[3] = state[7] = 2.0
    command = torch.tensor([[0.1], [2.0]], dtype=torch.float64)
    half = advance(car, state, command, 0.01, 5, TORCH)
    assert torch.equal(advance(car, half, command, 0.01, 5, TORCH), advance(car, state, command, 0.01, 10, TORCH))


def test_instant_actuators_start_from_the_first_command():
    car = make_car("sim=no_actuators")
    state = torch.zeros(8, 1, dtype=torch.float64)
    command = torch.tensor([[0.1], [2.0]], dtype=torch.float64)
    assert torch.equal(advance(car, state, command, 0.01, 1, TORCH)[6:8], command)
