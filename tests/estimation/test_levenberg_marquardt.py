"""The descent reaches the minimum, never goes up, keeps to its bounds and says when it is not there."""

from dataclasses import dataclass

import numpy as np
import pytest

from racerl.estimation.levenberg_marquardt import bounded_step, descend


@dataclass(frozen=True)
class Slope:
    cost: float
    J: np.ndarray
    r: np.ndarray


class Squares:
    """The sum of squared residuals over θ inside bounds."""

    def __init__(self, residuals, low=-np.inf, high=np.inf):
        self.residuals, self.low, self.high, self.seen = residuals, low, high, []

    def cost(self, theta):
        return float((self.residuals(theta) ** 2).sum())

    def linearise(self, theta):
        steps = 1e-6 * np.eye(len(theta))
        J = np.stack([(self.residuals(theta + h) - self.residuals(theta - h)) / 2e-6 for h in steps], axis=1)
        self.seen.append(self.cost(theta))
        return Slope(self.cost(theta), J, self.residuals(theta))

    def step(self, theta, slope, damping):
        low, high = np.full(len(theta), self.low), np.full(len(theta), self.high)
        return bounded_step(slope.J.T @ slope.J, slope.J.T @ slope.r, theta, low, high, np.ones(len(theta)), damping)


def valley(theta):
    """Rosenbrock's: curved, steep across and nearly flat along."""
    return np.array([10.0 * (theta[1] - theta[0] ** 2), 1.0 - theta[0]])


@pytest.mark.parametrize("start", [(-1.2, 1.0), (3.0, -4.0), (0.0, 0.0)])
def test_it_follows_a_curved_valley_to_its_end_and_never_goes_up(start):
    squares = Squares(valley)
    end = descend(squares, np.array(start), 200, 1e-10)
    assert end.converged and end.place == pytest.approx([1.0, 1.0], abs=1e-6)
    assert squares.seen == sorted(squares.seen, reverse=True)


def test_a_heavily_damped_step_that_gains_little_is_no_minimum():
    end = descend(Squares(lambda theta: theta - 3.0), np.array([0.0]), 100, 1e-3, damping=1e5)
    assert end.converged and end.place == pytest.approx([3.0], abs=1e-3)


def test_it_says_when_it_is_not_at_a_minimum():
    end = descend(Squares(valley), np.array([-1.2, 1.0]), 3, 1e-10)
    assert not end.converged and "still falls after 3 steps" in end.why
    assert not descend(Squares(lambda theta: theta * np.nan), np.array([1.0]), 9, 1e-6).converged


def test_bounds_hold_and_do_not_keep_the_others():
    end = descend(Squares(lambda theta: theta - np.array([5.0, 0.5]), high=1.0), np.zeros(2), 50, 1e-9)
    assert end.converged and end.place == pytest.approx([1.0, 0.5], abs=1e-6)
