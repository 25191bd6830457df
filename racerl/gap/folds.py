"""Folds: stretches of neighbouring windows, which are held out together."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from racerl.estimation.blocks import stretches
from racerl.gap.evidence import Evidence

Mask = NDArray[np.bool_]
STRETCH = 6  # windows that are held out together


def blocks(evidence: Evidence) -> NDArray[np.int64]:
    """Return a number per window: neighbours of one run that are held out, and resampled, together."""
    return stretches(evidence.run, evidence.start, STRETCH * evidence.length)


def deal(evidence: Mapping[str, Evidence], count: int) -> list[dict[str, Mask]]:
    """Return masks of the windows that each fold holds out: stretches of a few seconds, dealt in turn.

    So every manoeuvre is in all folds; whole runs would leave what only one of them excites to chance.
    """
    turn = {name: blocks(each) % count for name, each in evidence.items()}
    return [{name: number == fold for name, number in turn.items()} for fold in range(count)]
