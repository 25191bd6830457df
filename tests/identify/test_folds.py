"""Every window is held out once, and what is seen shares no sample with what is not."""

import numpy as np
import pytest

from racerl.identify.folds import deal
from racerl.identify.windows import choose_wiring, cut
from tests.identify.test_windows import drive
from tests.vehicle.conftest import make_car

LENGTH = 20


@pytest.mark.parametrize("rows, folds, how", [((200, 150, 90, 90, 60), 3, "whole runs"), ((400, 300), 4, "stretches")])
def test_folds(rows, folds, how):
    log = drive(rows)
    wiring = choose_wiring([log])
    windows = cut([log], wiring, wiring.driven(make_car()), LENGTH, 1, 0.0)
    dealt, said = deal(windows, folds)
    assert said.startswith(how) and len(dealt) == folds
    held = np.zeros(windows.windows.count, dtype=int)
    for fold in dealt:
        seen, unseen = fold.seen(windows), fold.unseen(windows)
        held += unseen
        assert seen.any() and unseen.any()
        for run in np.unique(windows.run):
            touched = {s + k for s in windows.start[unseen & (windows.run == run)] for k in range(LENGTH + 1)}
            known = {s + k for s in windows.start[seen & (windows.run == run)] for k in range(LENGTH + 1)}
            assert not touched & known
    assert held.max() == 1 and (held.min() == 1 or how == "stretches")
