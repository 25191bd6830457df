"""Folds: stretches of neighbouring windows, which are held out together."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from racerl.estimation.blocks import stretches
from racerl.gap.evidence import Evidence

Mask = NDArray[np.bool_]
STRETCH = 6  # windows that are held out together


def blocks(evidence: Mapping[str, Evidence]) -> dict[str, NDArray[np.int64]]:
    """Return a number per window of every stage: neighbours of one run that are held out, and resampled, together.

    The same seconds of a run have one number in all stages: what disturbs the car there disturbs it in each.
    """
    if not evidence:
        return {}
    run, start = (np.concatenate([getattr(each, key) for each in evidence.values()]) for key in ("run", "start"))
    rows = STRETCH * max(each.length for each in evidence.values())
    ends = np.cumsum([len(each.start) for each in evidence.values()])
    return dict(zip(evidence, np.split(stretches(run, start, rows), ends[:-1]), strict=True))


def deal(evidence: Mapping[str, Evidence], count: int) -> list[dict[str, Mask]]:
    """Return masks of the windows that each fold holds out: stretches of a few seconds, dealt in turn.

    So every manoeuvre is in all folds; whole runs would leave what only one of them excites to chance.
    """
    turn = {name: number % count for name, number in blocks(evidence).items()}
    return [{name: number == fold for name, number in turn.items()} for fold in range(count)]
