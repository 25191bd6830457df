"""Intervals cover the truth as often as they say, and what can't be told apart is named."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from racerl.estimation.unknowns import Unknowns
from racerl.identify.methods import Fit
from racerl.identify.objective import Linearised, Point
from racerl.identify.score import ErrorSum, held_errors, horizons_within
from racerl.identify.uncertainty import Uncertainty, describe, estimate, normal
from racerl.vehicle.parameter import Parameter

TRUTH = np.array([2.0, -1.0, 0.5])


def linear_fit(seed, design=None, count=120, noise=0.3, expected=None):
    """A linear problem y = Jθ + noise with one state per window that takes up nothing; the prior is `expected`."""
    generator = np.random.default_rng(seed)
    J = generator.standard_normal((count, 5, 3)) if design is None else design(generator, count)
    y = J @ TRUTH + noise * generator.standard_normal((count, 5))
    tt = np.einsum("wki,wkj->wij", J, J)
    penalty, start = (0.0, np.zeros(3)) if expected is None else (noise**2, expected)
    right = np.einsum("wki,wk->i", J, y) + penalty * start
    theta = np.linalg.solve(tt.sum(0) + (penalty + 1e-9) * np.eye(3), right)
    e = J @ theta - y
    none = np.zeros((count, 3, 1))
    t, x, xx = np.einsum("wki,wk->wi", J, e), none[:, 0], np.ones((count, 1, 1))
    at = Linearised(tt, none, xx, t, x, cost=1.0, data=float((e**2).sum()), squares=e**2)
    names = ("a", "b", "c")
    specification = (Parameter("", -9, 9, ""),) * 3
    unknowns = Unknowns(names, start, np.ones(3), np.full(3, -9.0), np.full(3, 9.0), specification)
    objective = SimpleNamespace(unknowns=unknowns, penalty=penalty)
    return Fit(Point(theta, np.zeros((1, count))), at, 1, True), objective, count * 5


def cut_of(run):
    """Windows of five samples, one after the other within each run."""
    start = 5 * (np.arange(len(run)) - np.searchsorted(run, run))
    return SimpleNamespace(run=run, start=start, windows=SimpleNamespace(inputs=np.zeros((4, 2, len(run)))))


def test_what_only_the_prior_knows_is_as_wide_as_the_prior():
    def design(generator, count):
        return generator.standard_normal((count, 5, 3)) * np.array([1.0, 1.0, 1e-6])

    for run in (np.arange(120), np.zeros(120, dtype=int)):  # by resampling, and from one run's curvature
        fit, objective, independent = linear_fit(3, design)
        fit.point.theta[2] = 0.0  # the plain least squares' value is noise
        objective.penalty = fit.linearised.data / independent
        draws = estimate(fit, objective, cut_of(run), independent, 0).draws
        assert 0.85 < draws[:, 2].std() < 1.15 and draws[:, 0].std() < 0.05


def test_few_windows_are_no_certainty():
    fit, objective, independent = linear_fit(4, count=3)
    draws = estimate(fit, objective, cut_of(np.zeros(3, dtype=int)), independent, 0).draws
    assert (draws.std(axis=0) > 0.02).all()


def test_intervals_cover_the_truth():
    inside = []
    for seed in range(60):
        fit, objective, independent = linear_fit(seed)
        low, high = np.percentile(
            estimate(fit, objective, cut_of(np.arange(120) // 3), independent, 0).draws, [2.5, 97.5], axis=0
        )
        inside.append((low <= TRUTH) & (high >= TRUTH))
    assert 0.88 <= np.mean(inside) <= 0.99


@pytest.mark.slow
def test_intervals_cover_a_truth_that_was_not_expected():
    """A prior eight deviations off draws the fit back by more than its noise; the interval reaches the truth."""
    for run in (np.arange(24), np.zeros(24, dtype=int)):  # by resampling, and from few blocks' curvature
        inside, pulled = [], []
        for seed in range(40):
            fit, objective, independent = linear_fit(seed, count=24, noise=3.0, expected=TRUTH - 8.0)
            draws = estimate(fit, objective, cut_of(run), independent, 0).draws
            low, high = np.percentile(draws, [2.5, 97.5], axis=0)
            inside.append((low <= TRUTH) & (high >= TRUTH))
            pulled.append(TRUTH - fit.point.theta)
        assert np.mean(pulled) > 0.4 and np.mean(inside) > 0.9


def test_what_was_settled_before_widens_the_rest():
    """Two steps: c from data of its own, then a and b with c held; all intervals cover the truth."""
    inside, alone = [], []
    for seed in range(20):
        fit, objective, independent = linear_fit(seed)
        error = 0.05 * np.random.default_rng(seed + 1000).standard_normal()
        objective.unknowns = objective.unknowns.settled({"c": TRUTH[2] + error})
        tt, tb = fit.linearised.tt.sum(0), (fit.linearised.tt @ fit.point.theta).sum(0) - fit.linearised.t.sum(0)
        theta = np.append(np.linalg.solve(tt[:2, :2], tb[:2] - tt[:2, 2] * (TRUTH[2] + error)), TRUTH[2] + error)
        gradient = fit.linearised.t + fit.linearised.tt @ (theta - fit.point.theta)
        fit = Fit(Point(theta, fit.point.initial), replace(fit.linearised, t=gradient), 1, True)
        draws = TRUTH[2] + error + 0.05 * np.random.default_rng(seed).standard_normal((1000, 1))
        earlier = [Uncertainty(("c",), draws, np.array([[0.05**2]]))]
        found = estimate(fit, objective, cut_of(np.arange(120) // 3), independent, 0, earlier)
        low, high = np.percentile(found.draws, [2.5, 97.5], axis=0)
        inside.append((low <= TRUTH) & (high >= TRUTH))
        alone.append(found.half_width[2])
    assert np.mean(inside) >= 0.88 and np.allclose(alone, 1.96 * 0.05)


def test_all_may_be_settled_before():
    fit, objective, independent = linear_fit(0)
    draws = np.random.default_rng(0).standard_normal((1000, 3))
    earlier = [Uncertainty(objective.unknowns.names, draws, np.eye(3))]
    found = estimate(fit, objective, cut_of(np.arange(120)), independent, 0, earlier)
    assert np.allclose(found.draws, draws) and np.allclose(found.covariance, np.eye(3))


def test_half_width_is_the_covariances():
    fit, objective, independent = linear_fit(0)
    sigma = np.sqrt(np.diag(np.linalg.inv(fit.linearised.tt.sum(0))) * fit.linearised.data / independent)
    assert np.allclose(
        estimate(fit, objective, cut_of(np.zeros(120, dtype=int)), independent, 0).half_width, 1.96 * sigma, rtol=1e-6
    )


def test_twins_are_named_not_separable():
    def design(generator, count):
        J = generator.standard_normal((count, 5, 3))
        J[..., 1] = J[..., 0] + 0.05 * J[..., 1]
        return J

    fit, objective, independent = linear_fit(1, design)
    table, pairs = describe(
        objective.unknowns, fit.point.theta, estimate(fit, objective, cut_of(np.arange(120)), independent, 0)
    )
    assert [sorted(pair["parameters"]) for pair in pairs] == [["a", "b"]]
    assert table["a"]["not_separable_from"] == ["b"] and not table["a"]["identified"]
    assert table["c"]["identified"] and table["c"]["not_separable_from"] == []


def test_what_the_data_do_not_touch_is_wide_open_whatever_the_scale():
    def design(generator, count):
        J = generator.standard_normal((count, 5, 3)) * np.array([1e6, 1.0, 0.0])
        J[:, 0, 2] = 1e-9
        return J

    fit, objective, independent = linear_fit(2, design)
    half_width = estimate(fit, objective, cut_of(np.arange(120)), independent, 0).half_width
    assert half_width[0] < 1e-6 < half_width[1] < 1.0 < 1e3 < half_width[2]


def test_scores_by_hand():
    measured = np.array([[[1.0]], [[2.0]], [[4.0]]])  # one channel, one window, three samples
    total = ErrorSum(["v_x"], [1, 2])
    total.add(held_errors(SimpleNamespace(windows=SimpleNamespace(measured=measured))))
    assert total.rmse() == {"1": {"v_x": 1.0}, "2": {"v_x": np.sqrt((1 + 9) / 2)}}


def test_a_diverged_rollout_is_not_hidden():
    total = ErrorSum(["v_x"], [2])
    total.add(np.array([[[0.0, 0.0]], [[0.1, np.nan]], [[0.1, np.nan]]]))
    assert total.rmse()["2"]["v_x"] is None


def test_horizons():
    assert horizons_within(85) == [1, 5, 20, 50, 85] and horizons_within(30) == [1, 5, 20, 30]


def test_draws_have_the_covariance():
    generator, mean, covariance = np.random.default_rng(1), [1.0, -2.0], np.array([[0.04, -0.018], [-0.018, 0.01]])
    cars = mean + np.concatenate([normal(covariance, generator) for _ in range(100)])
    assert len(cars) == 100_000 and np.allclose(cars.mean(axis=0), mean, atol=0.002)
    assert np.allclose(np.cov(cars.T), covariance, rtol=0.02)
