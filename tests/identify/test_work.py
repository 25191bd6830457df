"""Progress only goes forward, and ends at 1, however long the fits turn out to be."""

import pytest

from racerl.identify.task import plan
from racerl.identify.work import Work


def test_of_a_hard_log(lacking):
    assert lacking.shares == sorted(lacking.shares) and lacking.shares[-1] == 1.0


@pytest.mark.parametrize("lengths", [[3, 1, 1, 2, 3, 2, 1, 0], [19, 55, 1, 3, 9, 49, 1, 2], [0, 80, 2, 1, 1, 90, 7, 1]])
def test_of_fits_of_any_length(lengths):
    shares = []
    work = Work([*plan(100, 1), *plan(75, 1)], lambda share, remark: shares.append(share))
    for steps in lengths:
        for number in range(1, steps + 1):
            work.step(number, 0.0)
        work.finish()
    assert shares == sorted(shares) and shares[0] < 0.1 and shares[-1] == 1.0


def test_later_fits_are_as_long_as_those_before():
    told = []
    work = Work([(0, 100), (0, 100)], lambda share, remark: told.append((share, remark)))
    for number in range(1, 41):
        work.step(number, 0.0)
    work.finish()
    assert told[-1] == (0.5, "fit 2 of 2")
    work.step(20, 0.0)
    assert told[-1][0] == pytest.approx(0.75)
