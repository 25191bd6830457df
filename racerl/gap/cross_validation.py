"""Cross-validation: the cost of every window under parameters that have not seen its fold."""

import numpy as np
from numpy.typing import NDArray

from racerl.gap.fitted_model import FittedModel
from racerl.gap.folds import Mask
from racerl.gap.investigation import Investigation

Array = NDArray[np.float64]


def held_out(investigation: Investigation, found: FittedModel) -> dict[str, Array]:
    """Return the cost of every window under parameters that have not seen its fold, per stage."""
    checkpoint, folds = investigation.checkpoint, _folds(investigation, found)
    parts = checkpoint.recall(
        checkpoint.key("held out", found.key, folds),
        lambda: dict(zip(found.cost, found.problem.held_out(found.fit, folds), strict=True)),
    )
    return {name: parts[name] for name in found.cost}


def held_out_errors(investigation: Investigation, found: FittedModel) -> dict[str, Array]:
    """Return simulated − measured (T + 1, C, W) per stage, likewise."""
    errors = found.problem.held_out_errors(found.fit, _folds(investigation, found))
    return dict(zip(found.cost, errors, strict=True))


def _folds(investigation: Investigation, found: FittedModel) -> list[list[Mask]]:
    return [[fold[name] for name in found.cost] for fold in investigation.folds]
