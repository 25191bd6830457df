"""Tracks: smooth, periodic, of the right size, and honest about bad input."""

import numpy as np
import pytest

from racerl.errors import TrackError
from racerl.track.load import read_track
from racerl.track.track import build_track
from tests.conftest import CONF


def circle(radius=5.0, points=60, width=0.5, clockwise=False):
    angle = np.arange(points) / points * 2 * np.pi * (-1 if clockwise else 1)
    return radius * np.stack([np.cos(angle), np.sin(angle)], axis=1), np.full(points, width), np.full(points, width)


@pytest.fixture(scope="module")
def l_track():
    return read_track(CONF / "track" / "l_shape.csv")


@pytest.mark.parametrize("clockwise", [False, True])
def test_a_circle_has_its_length_and_curvature(clockwise):
    track = build_track("circle", *circle(clockwise=clockwise))
    assert track.length == pytest.approx(2 * np.pi * 5.0, rel=1e-4)
    assert np.allclose(track.curvature, -0.2 if clockwise else 0.2, rtol=1e-2)


def test_the_tables_are_consistent(l_track):
    """Yaw is the direction of the points, curvature the derivative of yaw, all periodically."""
    ds = l_track.spacing
    dx, dy = np.roll(l_track.x, -1) - np.roll(l_track.x, 1), np.roll(l_track.y, -1) - np.roll(l_track.y, 1)
    assert np.abs(np.angle(np.exp(1j * (np.arctan2(dy, dx) - l_track.yaw)))).max() < 1e-3
    turn = np.angle(np.exp(1j * (np.roll(l_track.yaw, -1) - np.roll(l_track.yaw, 1))))
    assert np.abs(turn / (2 * ds) - l_track.curvature).max() < 5e-3
    assert np.sum(l_track.curvature) * ds == pytest.approx(-2 * np.pi, abs=1e-3)  # once around, clockwise
    assert np.hypot(dx, dy) == pytest.approx(2 * ds, rel=1e-2)


def test_the_l_track_is_the_papers(l_track):
    assert l_track.length == pytest.approx(17.5, abs=0.05)
    assert l_track.curvature.min() == pytest.approx(-2.1, abs=0.1)
    assert np.allclose(l_track.width_left, 0.5) and np.allclose(l_track.width_right, 0.5)


def test_the_l_track_passes_its_points(l_track):
    points = np.loadtxt(CONF / "track" / "l_shape.csv", delimiter=",")
    distance = np.hypot(points[:, None, 0] - l_track.x, points[:, None, 1] - l_track.y).min(axis=1)
    assert distance.max() < l_track.spacing / 2 + 5e-3


def test_curvature_is_smooth_across_the_seam(l_track):
    steps = np.abs(np.diff(l_track.curvature, append=l_track.curvature[0]))
    assert steps[-1] <= steps.max() and steps.max() < 4.0 * l_track.spacing


def test_rounded_points_do_not_ripple():
    points, right, left = circle(points=300)
    track = build_track("rounded", np.round(points, 4), right, left)
    assert np.abs(track.curvature - 0.2).max() < 0.01


def test_widths_stay_between_their_neighbours():
    points, right, left = circle()
    right[10], left[30] = 0.1, 3.0
    track = build_track("pinched", points, right, left)
    assert track.width_right.min() == pytest.approx(0.1, abs=1e-3) and track.width_left.max() <= 3.0 + 1e-9


def test_the_first_point_may_be_repeated():
    points, right, left = circle()
    again = build_track("closed", np.vstack([points, points[:1]]), np.append(right, 0.5), np.append(left, 0.5))
    assert again.length == pytest.approx(build_track("open", points, right, left).length, rel=1e-9)


@pytest.mark.parametrize(
    "spoil, said",
    [
        (lambda p, r, w: (p[:40], r[:40], w[:40]), "does not close"),
        (lambda p, r, w: (p[:5], r[:5], w[:5]), "5 distinct points"),
        (lambda p, r, w: (p, r * 0, w), "right width 0"),
        (lambda p, r, w: (p, r, w - 1), "left width -0.5"),
        (lambda p, r, w: (np.where(p == p[3], np.nan, p), r, w), "NaN"),
        (lambda p, r, w: (p * 1e5, r, w), "is it in metres"),
        (lambda p, r, w: (np.where(np.arange(60)[:, None] == 10, 2000.0, p), r, w), "the line through its points is"),
        (lambda p, r, w: (p, r, w * 1e300), "left width 5e[+]299 m at point 0, at most"),
        (lambda p, r, w: (p * 0, r, w), "distinct points"),
        (lambda p, r, w: (p[:, :1], r, w), "shape"),
    ],
)
def test_bad_tracks_are_refused_in_one_line(spoil, said):
    with pytest.raises(TrackError, match=said) as error:
        build_track("bad", *spoil(*circle()))
    assert "\n" not in str(error.value)
