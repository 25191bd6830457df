"""Lap timing and scoring on made-up drives whose laps are known."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from racerl.evaluate.laps import Lap, LapTimer, mean_interval, score

DT = 0.05


def drive(speed, laps=3, length=10.0, start=7.0, margin=lambda s: 0.5, crash_at=None):
    """Drive one car at a constant speed; crash once at a distance and go on from the middle."""
    timer = LapTimer(length, DT, np.array([start]))
    s = start
    while timer.fewest() < laps:
        after = s + speed * DT
        crashed = crash_at is not None and s < crash_at <= after
        restart = 5.0 if crashed else after
        timer.update(
            np.array([s]), np.array([after]), np.array([margin(after)]), np.array([crashed]), np.array([restart])
        )
        s, crash_at = restart, None if crashed else crash_at
    return timer.laps[0]


@given(st.floats(1.0, 7.0), st.floats(0.0, 9.99))
def test_lap_times_are_interpolated(speed, start):
    for lap in drive(speed, start=start):
        assert lap.time_s == pytest.approx(10.0 / speed, abs=1e-9)
        assert lap.valid and lap.e_off == 0.0


def test_leaving_the_track_is_measured_and_makes_a_lap_invalid():
    """0.1 m beyond the boundary for a quarter of each lap."""
    laps = drive(2.0, margin=lambda s: -0.1 if s % 10.0 < 2.5 else 0.3)
    for lap in laps:
        assert not lap.valid and lap.max_off_track_m == pytest.approx(0.1)
        assert lap.e_off == pytest.approx(0.1 * 2.5 / 2.0, abs=0.1 * DT)


def test_the_way_to_the_line_does_not_count():
    laps = drive(2.0, start=0.5, margin=lambda s: -0.3 if s < 9.0 else 0.3)
    assert all(lap.valid for lap in laps)


def test_a_crash_ends_a_lap_without_a_time():
    laps = drive(2.0, crash_at=14.0)
    assert [lap.crashed for lap in laps] == [True, False, False]
    assert laps[0].time_s is None and laps[1].time_s == pytest.approx(5.0)
    assert [lap.number for lap in laps] == [1, 2, 3]


def test_a_crash_on_the_way_to_the_line_is_a_lap_driven():
    laps = drive(2.0, start=1.0, crash_at=6.0)
    assert laps[0].crashed and laps[1].time_s == pytest.approx(5.0)


def test_driving_back_over_the_line_times_no_lap():
    timer = LapTimer(10.0, DT, np.array([9.5]))
    path = [9.5, 10.2, 9.6, 10.3, 15.0, 20.5]
    for before, after in itertools.pairwise(path):
        timer.update(*(np.array([v]) for v in (before, after, 1.0)), np.array([False]), np.array([after]))
    assert len(timer.laps[0]) == 1


def lap(time, car=0, e_off=0.0, crashed=False):
    return Lap(car=car, number=1, time_s=None if crashed else time, e_off=e_off, max_off_track_m=e_off, crashed=crashed)


def test_scores_are_the_papers():
    result = score([lap(6.0), lap(5.0, e_off=0.2), lap(7.0), lap(0.0, crashed=True, e_off=0.4)])
    assert result["laps"] == 4 and result["valid_laps"] == 2
    assert result["fastest_valid_lap_s"] == 6.0  # 5.0 s left the track
    assert result["mean_lap_s"] == pytest.approx(6.0) and result["std_lap_s"] == pytest.approx(1.0)
    assert result["e_off"] == pytest.approx(0.15) and result["crash_share"] == 0.25
    assert result["max_off_track_m"] == pytest.approx(0.4)


def test_settled_laps_follow_another_one():
    """Neither a car's first lap nor the one after a crash counts."""
    laps = [lap(6.0), lap(5.0), lap(0.0, crashed=True), lap(7.0), lap(5.2), lap(8.0, car=1), lap(5.4, car=1)]
    assert score(laps)["settled_lap_s"] == pytest.approx((5.0 + 5.2 + 5.4) / 3.0)
    assert score([lap(6.0), lap(6.0, car=1)])["settled_lap_s"] is None


def test_nothing_is_made_up_without_laps():
    result = score([lap(0.0, crashed=True)])
    assert result["fastest_valid_lap_s"] is None and result["mean_lap_s"] is None and result["std_lap_s"] is None


def test_the_interval_covers_the_mean_at_its_rate():
    """A t-interval over cars, not over laps, which are alike within a car."""
    draw = np.random.default_rng(0)
    hits = 0
    for _ in range(400):
        laps = [lap(t, car) for car in range(4) for t in [draw.normal(6.0, 0.1)] * 20]
        low, high = mean_interval(laps)
        hits += low <= 6.0 <= high
    assert 0.92 <= hits / 400 <= 0.98
    assert mean_interval([lap(5.0)]) is None
