"""Gauss-Newton and AdamW find the same car, inside the bounds, again and again."""

import dataclasses

import numpy as np
import pytest

from racerl.data.load import load_given
from racerl.errors import ConfigError
from racerl.estimation.unknowns import choose_unknowns
from racerl.identify.methods.adamw import Adamw
from racerl.identify.methods.gauss_newton import GaussNewton
from racerl.identify.objective import Objective
from racerl.identify.uncertainty import estimate
from racerl.identify.windows import channel_scale, choose_wiring, cut
from racerl.vehicle.load import load_vehicle
from racerl.vehicle.rollout import Rollout
from tests.identify.conftest import settings_for

# few and separable, so that first-order descent arrives within a test's patience
PRIORS = {"*.time_constant": 0.5, "*.p_K[xy]1": 0.3, "*.p_Dy1": 0.3, "yaw_inertia": 0.2}


def nothing(iteration: int, cost: float) -> None:
    pass


@pytest.fixture(scope="module")
def problem(hidden):
    settings = settings_for(hidden / "log.parquet")
    logs = load_given(settings)
    wiring, car = choose_wiring(logs), load_vehicle(settings["vehicle"])
    unknowns = choose_unknowns(car, PRIORS, [], car)
    rollout = Rollout(car, unknowns.names, wiring.observed)
    windows = cut(logs, wiring, car, 85, 85, 0.5)
    scale = channel_scale(logs, wiring.observed)
    return Objective(rollout, unknowns, windows.windows, scale, np.ones(len(scale)), penalty=1e-6), windows


@pytest.mark.slow
def test_adamw_and_gauss_newton_agree_within_their_intervals(problem):
    objective, windows = problem
    start = objective.start(objective.unknowns.start)
    fits = [GaussNewton().fit(objective, start, nothing), Adamw(iterations=300).fit(objective, start, nothing)]
    assert fits[0].steps < 30 and fits[0].converged
    assert fits[1].linearised.cost == pytest.approx(fits[0].linearised.cost, rel=1e-3)
    intervals = [np.percentile(estimate(f, objective, windows, 1000.0, 0).draws, [2.5, 97.5], axis=0) for f in fits]
    for fit, (low, high) in zip(fits, intervals[::-1], strict=True):
        assert ((low <= fit.point.theta) & (fit.point.theta <= high)).all()


def test_back_propagation_through_time_takes_the_same_path(problem):
    objective, _ = problem
    few = Objective(
        objective.rollout,
        objective.unknowns,
        objective.windows.take(np.arange(4)),
        np.ones(5),
        np.ones(5),
        penalty=1e-6,
    )
    start = few.start(few.unknowns.start)
    kernel, torch = (Adamw(3, 0.05, gradient).fit(few, start, nothing) for gradient in ("kernel", "torch"))
    assert np.allclose(kernel.point.theta, torch.point.theta, rtol=1e-8)


def test_bounds_are_kept_and_the_rest_still_fits(problem):
    objective, _ = problem
    i = objective.unknowns.names.index("steering.time_constant")
    # the truth lies below
    low = np.where(
        np.arange(len(objective.unknowns.names)) == i, objective.unknowns.start * 0.9, objective.unknowns.low
    )
    tight = dataclasses.replace(objective.unknowns, low=low)
    start = objective.start(tight.clip(tight.start))
    objective.unknowns, free = tight, objective.unknowns
    fit = GaussNewton().fit(objective, start, nothing)
    objective.unknowns = free
    assert fit.point.theta[i] == tight.low[i]
    assert fit.linearised.cost < objective.linearise(start).cost


@pytest.mark.parametrize(
    "make",
    [lambda: GaussNewton(0), lambda: GaussNewton(tolerance=2.0), lambda: Adamw(rate=-1), lambda: Adamw(gradient="x")],
)
def test_settings_out_of_range(make):
    with pytest.raises(ConfigError, match="allowed"):
        make()
