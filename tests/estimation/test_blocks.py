"""Windows and blocks of them: what identify and gap cut, hold out and draw."""

import numpy as np
import pytest

from racerl.estimation.blocks import CLEAR, counts, nested_counts, resampled, standard_error, stretches, winsorised
from racerl.estimation.windows import window_starts


def test_windows_leave_out_the_ends_and_what_is_slow():
    assert window_starts(10, 3, 3).tolist() == [0, 3, 6]
    assert window_starts(10, 3, 3, before=1, after=1).tolist() == [1, 4]
    speed = np.ones(10)
    speed[4] = 0.0  # in the windows that begin at 3 and, by its last sample, at 1
    assert window_starts(10, 3, 1, speed, 0.5).tolist() == [0, 5, 6]
    assert window_starts(3, 3, 1, np.ones(3), 0.5).tolist() == []


def test_neighbours_of_one_run_are_one_block():
    run, start = np.array([0, 0, 0, 1, 1]), np.array([0, 40, 100, 0, 99])
    assert stretches(run, start, 100).tolist() == [0, 0, 1, 2, 2]


def test_a_bootstrap_draws_as_many_blocks_as_there_are():
    drawn = counts(7, 50, np.random.default_rng(0))
    assert drawn.shape == (50, 7) and (drawn.sum(axis=1) == 7).all() and drawn.min() == 0 and drawn.max() > 1


def test_runs_are_drawn_first_then_their_stretches():
    group = np.array([3, 3, 3, 5, 5, 8])
    drawn = nested_counts(group, 4000, np.random.default_rng(0))
    by_run = np.stack([drawn[:, group == each].sum(axis=1) / (group == each).sum() for each in (3, 5, 8)], axis=1)
    assert (by_run == by_run.round()).all() and (by_run.sum(axis=1) == 3).all()
    assert drawn.mean(axis=0) == pytest.approx(np.ones(6), abs=0.05)
    # three draws of three runs leave one out in (2/3)³; its blocks differ among each other as well
    assert (by_run == 0).mean() == pytest.approx(8 / 27, abs=0.02) and (drawn[:, 0] != drawn[:, 1]).mean() > 0.3


def test_of_a_single_run_stretches_are_drawn():
    alone, plain = (draw(9, 4000, np.random.default_rng(seed)) for draw, seed in ((_in_one_run, 1), (counts, 2)))
    assert (alone.sum(axis=1) == 9).all() and alone.var(axis=0) == pytest.approx(plain.var(axis=0), rel=0.15)


def _in_one_run(count, draws, generator):
    return nested_counts(np.zeros(count, dtype=int), draws, generator)


def test_the_spread_of_resampled_sums_is_the_standard_error():
    sums = np.random.default_rng(1).normal(2.0, 3.0, size=(200, 2))
    totals = resampled(sums, 4000, np.random.default_rng(2))
    assert totals.mean(axis=0) == pytest.approx(sums.sum(axis=0), rel=0.01)
    assert totals.std(axis=0) == pytest.approx(sums.std(axis=0) * np.sqrt(200), rel=0.05)


@pytest.mark.parametrize("count, outer", [(4, 0), (12, 1), (60, 1)])
def test_as_many_standard_errors_as_are_clear_come_by_chance_once_in_hundreds(count, outer):
    """Φ(−3) is 0.13 %; without Student's law four blocks would pass 4 % of the time, twelve, winsorised, 2 %."""
    sums = np.random.default_rng(5).normal(size=(20_000, count))
    clear = [winsorised(row, outer).sum() > CLEAR * standard_error(row, outer) for row in sums]
    assert np.mean(clear) == pytest.approx(0.00135, abs=0.001)


def test_ten_blocks_that_all_gain_are_no_chance_however_unequal():
    uneven = np.array([29.0, 29, 37, 38, 75, 84, 101, 102, 201, 235])
    assert uneven.sum() > CLEAR * standard_error(uneven, 1)
    assert standard_error(np.append(uneven, -1.0), 1) > 1.5 * standard_error(uneven, 1)  # one of them loses a little
    assert standard_error(-uneven, 1) == standard_error(uneven, 1)


def test_a_single_block_tells_nothing():
    assert standard_error(np.array([5.0]), 0) == np.inf
