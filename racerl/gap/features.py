"""What a round of naming saw, as plain numbers: what a calibrated rule is fitted to and decides by."""

from collections.abc import Sequence
from typing import Any

from racerl.gap.comparison import CandidateScore, Judge, Standing, excesses
from racerl.gap.fitted_model import touched


def features(judge: Judge, standing: Standing, rows: Sequence[CandidateScore]) -> dict[str, Any]:
    """Return the excess that a round began with, and what each candidate gains and leaves, best first.

    All excesses are over the noise's cost, by stage: on held-out windows, and by the fit to all windows.
    """
    investigation, noise = judge.investigation, standing.noise

    def over_noise(cost: dict[str, Any]) -> dict[str, float]:
        return {stage: part / noise[stage] for stage, part in excesses(investigation, cost, noise).items()}

    fit = {stage: investigation.cost(standing.found, stage) for stage in investigation.evidence}
    return {
        "held_out": over_noise(standing.cost),
        "fit": over_noise(fit),
        "candidates": [
            {
                "name": row.name,
                "needed": row.needed,
                "gain": row.gain,
                "error": row.error,
                "behind": row.behind,
                "leads": row.leads,
                "explained": row.explained,
                "worth": row.worth,
                "fall": row.fall,
                "like": row.like,
                "stages": touched(investigation, row.found.vehicle, [row.name]),
                "held_out": over_noise(row.cost),
                "fit": over_noise(row.found.cost),
            }
            for row in rows
        ],
    }
