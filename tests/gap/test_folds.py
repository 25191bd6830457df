"""Blocks of windows: which hang together over the stages, and what that makes of a gain's standard error."""

from types import SimpleNamespace

import numpy as np
import pytest

from racerl.gap.comparison import Judge
from racerl.gap.folds import STRETCH, blocks, deal

RUN = np.repeat([0, 1], 60)
START = np.tile(np.arange(60) * 10, 2) + 1000 * RUN
MOVES = (START % 1000 >= 150) | (RUN == 1)  # the car stands at first, and only the steering has windows there


def evidence(run, start):
    return SimpleNamespace(run=run, start=start, length=10, numbers=10)


LOG = {"steering": evidence(RUN, START), "chassis": evidence(RUN[MOVES], START[MOVES])}


def test_the_same_seconds_are_one_block_in_all_stages():
    number = blocks(LOG)
    assert (number["steering"][MOVES] == number["chassis"]).all()
    assert np.bincount(number["steering"]).max() == STRETCH
    assert len(set(number["steering"])) > len(set(number["chassis"]))


def test_and_are_held_out_together():
    for fold in deal(LOG, 4):
        assert (fold["steering"][MOVES] == fold["chassis"]).all() and 0 < fold["chassis"].sum() < MOVES.sum()


def test_a_gain_that_two_stages_have_in_the_same_seconds_is_no_surer_for_that():
    """Of independent stages the error would be √2 of one's."""
    log = {"steering": LOG["steering"], "drive": LOG["steering"]}
    base = SimpleNamespace(cost={stage: np.full(120, 1e9) for stage in log})  # so large a loss is all but linear
    judge = Judge(SimpleNamespace(evidence=log, base=base, seed=0), {})
    before = np.full(120, 300.0)
    after = before - np.random.default_rng(2).normal(1.0, 5.0, size=120)
    gain, error = judge.gain({"steering": before}, {"steering": after})
    both, doubled = judge.gain(dict.fromkeys(log, before), dict.fromkeys(log, after))
    assert both == pytest.approx(2.0 * gain) and doubled == pytest.approx(2.0 * error)
    opposite = {"steering": after, "drive": 2.0 * before - after}
    assert judge.gain(dict.fromkeys(log, before), opposite) == pytest.approx((0.0, 0.0), abs=1e-2)
