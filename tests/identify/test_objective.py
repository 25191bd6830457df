"""The objective: its gradient, the elimination of initial states, and the count of independent residuals."""

import dataclasses

import numpy as np
import pytest

from racerl.estimation.independence import independent_residuals
from racerl.estimation.unknowns import choose_unknowns
from racerl.identify.methods.adamw import torch_gradient
from racerl.identify.objective import Objective, Point
from racerl.vehicle.rollout import Rollout, drive_by
from tests.vehicle.conftest import make_car
from tests.vehicle.test_rollout import OBSERVED, windows_for

CAR = make_car()
# Gauss-Newton steps until the initial states rest: beyond the force peak the slowest window gains 0.7 with each
SETTLE = 40
PRIORS = {"yaw_inertia": 0.2, "*.p_Ky1": 0.3, "l_f": 0.05}
SENSORS = {"effects.lever_arm.forward": {"absolute": 0.05}, "effects.wheel_speed_gain.gain": {"absolute": 0.05}}


@pytest.fixture(scope="module")
def objective() -> Objective:
    return objective_of(CAR, PRIORS)


def objective_of(car, priors) -> Objective:
    unknowns = choose_unknowns(car, priors, [], car)
    rollout = Rollout(car, unknowns.names, OBSERVED)
    windows = windows_for(car, count=9)
    noise = 0.02 * np.random.default_rng(1).standard_normal(windows.measured.shape)
    windows = dataclasses.replace(windows, measured=rollout.predict(0.97 * unknowns.start, windows) + noise)
    scale, weight = np.array([0.5, 0.3, 1.5]), np.array([1.0, 1.0, 2.0])
    return Objective(rollout, unknowns, windows, scale, weight, penalty=0.01)


def test_cost_is_the_weighted_mean_square_and_the_prior(objective):
    theta = objective.unknowns.start + 0.5 * objective.unknowns.sigma
    point = objective.start(theta)
    error = objective.residuals(point) / np.array([0.5, 0.3, 1.5])[:, None]
    expected = ((error**2).mean(axis=(0, 2)) * np.array([1.0, 1.0, 4.0])).sum() / 6.0 + 0.01 * 0.25 * len(theta)
    assert objective.linearise(point).cost == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("shown_by_sensors", [False, True])
def test_gradient_by_finite_differences_and_by_back_propagation(objective, shown_by_sensors):
    if shown_by_sensors:
        car = make_car("+vehicle/effect=[lever_arm,wheel_speed_gain]")
        objective = objective_of(drive_by(car, measured_steering=False, measured_speed=True), PRIORS | SENSORS)
    theta = objective.unknowns.start * 1.05
    at = objective.linearise(objective.start(theta))
    numeric = np.empty_like(theta)
    for i in range(len(theta)):
        h = 1e-6 * theta[i]
        data = [objective.linearise(objective.start(theta + s * h * np.eye(len(theta))[i])).data for s in (1, -1)]
        numeric[i] = (data[0] - data[1]) / (2 * h) / 2
    assert np.allclose(at.t.sum(axis=0), numeric, rtol=1e-6)
    assert np.allclose(at.t.sum(axis=0), torch_gradient(objective, objective.start(theta)), rtol=1e-9)


def test_initial_states_settle_where_they_fit_best(objective):
    point = objective.start(objective.unknowns.start)
    before = objective.linearise(point)
    for _ in range(SETTLE):
        point = objective.moved(point, objective.linearise(point), point.theta, 1e-3)
    after = objective.linearise(point)
    assert after.data < before.data
    assert np.abs(after.x).max() < 1e-6 * np.abs(before.x).max()
    # states that nothing observes depends on stay as they were
    assert np.array_equal(point.initial[:3], objective.windows.initial[:3])


def test_reduced_gradient_is_the_total_derivative(objective):
    """At settled initial states, moving θ and letting them follow changes the cost as the reduced curvature says."""
    theta = objective.unknowns.start
    point = objective.start(theta)
    for _ in range(SETTLE):
        point = objective.moved(point, objective.linearise(point), theta, 1e-6)
    at = objective.linearise(point)
    _, g = at.reduced()
    h = 1e-4 * objective.unknowns.sigma[0]

    def settled(step: float) -> float:
        moved = Point(theta + step * np.eye(len(theta))[0], point.initial)
        for _ in range(SETTLE):
            moved = objective.moved(moved, objective.linearise(moved), moved.theta, 1e-6)
        return objective.linearise(moved).data

    assert g.sum(axis=0)[0] == pytest.approx((settled(h) - settled(-h)) / (4 * h), rel=1e-4)


def test_an_unstable_car_costs_infinity(objective):
    theta = objective.unknowns.start.copy()
    theta[objective.unknowns.names.index("yaw_inertia")] = 1e-9
    assert objective.linearise(objective.start(theta)).cost == np.inf


def test_independent_residuals():
    generator = np.random.default_rng(0)
    white = generator.standard_normal((86, 2, 400))
    assert independent_residuals(white) == pytest.approx(white.size, rel=0.1)
    slow = np.zeros_like(white)
    for k in range(1, 86):  # AR(1) of coefficient 0.8: τ = 1.8/0.2 = 9
        slow[k] = 0.8 * slow[k - 1] + 0.6 * white[k]
    assert independent_residuals(slow[20:]) == pytest.approx(slow[20:].size / 9, rel=0.25)
