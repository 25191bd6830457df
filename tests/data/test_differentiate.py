"""Velocities from poses: exact on polynomials, right on a circle, indifferent to wrapped headings."""

import numpy as np
import pytest

from racerl.data.differentiate import slope, smoothed, velocities


def test_a_circle_gives_its_speed_and_yaw_rate():
    t = np.arange(0.0, 20.0, 0.01)
    angle = 1.5 * t
    slip = 0.1  # rad between heading and path
    v_x, v_y, yaw_rate = velocities(2 * np.cos(angle), 2 * np.sin(angle), angle + np.pi / 2 - slip, 0.01, 11, 3)
    np.testing.assert_allclose(v_x, 3.0 * np.cos(slip), atol=2e-4)
    np.testing.assert_allclose(v_y, 3.0 * np.sin(slip), atol=2e-4)
    np.testing.assert_allclose(yaw_rate, 1.5, atol=1e-9)


def test_wrapped_headings_make_no_spikes():
    t = np.arange(0.0, 20.0, 0.01)
    whole = velocities(t, 0 * t, 2.0 * t, 0.01, 11, 3)
    wrapped = velocities(t, 0 * t, np.angle(np.exp(2j * t)), 0.01, 11, 3)
    np.testing.assert_allclose(whole, wrapped, atol=1e-9)


@pytest.mark.parametrize("order", [2, 3, 5])
def test_polynomials_are_exact_up_to_the_ends(order):
    t = np.arange(0.0, 1.0, 0.01)
    v_x, _, _ = velocities(t**order, 0 * t, 0 * t, 0.01, 11, order)
    np.testing.assert_allclose(v_x, order * t ** (order - 1), atol=1e-8)


def test_runs_shorter_than_the_window_are_left_alone():
    assert (slope(np.ones(3), 0.01) == 0).all() and (smoothed(np.arange(3.0), 9) == np.arange(3.0)).all()
