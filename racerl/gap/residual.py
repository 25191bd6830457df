"""What is offered where no known effect explains the gap: a bounded residual that is learned like any effect.

Its weights have a prior around zero, so that what the data do not ask for stays small; it fades outside of what the log
has seen; and it has no physical name.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from racerl.gap.investigation import Found, Investigation, Screened, with_effect
from racerl.gap.name import Decision, Judge
from racerl.vehicle.effects.learned_residual import LearnedResidual

NAME = "learned_residual"
CHANNELS = {"speed": ("v_x", "omega"), "steering": ("delta", "delta_ref"), "yaw_rate": ("yaw_rate",)}
SEEN = 0.995  # quantile that counts as the greatest value seen


def limits(investigation: Investigation) -> LearnedResidual:
    """Return the residual before learning, with the limits of what the logs show."""
    columns: Mapping[str, Any] = next(iter(investigation.evidence.values())).columns
    seen = {}
    for key, names in CHANNELS.items():
        channel = next((name for name in names if name in columns), None)
        if channel:
            seen[key] = max(float(np.quantile(np.abs(columns[channel]), SEEN)), 0.1)
    return LearnedResidual(**seen)


def learn(investigation: Investigation, decision: Decision, seed: int) -> tuple[dict[str, Any], Found]:
    """Fit the residual beside the refitted vehicle; return what it explains on held-out windows, and the fit.

    `investigation` is one whose catalogue holds the residual alone.
    """
    base = investigation.base
    cost = investigation.held_out(base)
    judge = Judge(investigation, np.random.default_rng(seed), cost)
    vehicle = with_effect(base.vehicle, NAME, investigation.catalogue[NAME][0])
    found = investigation.converged(investigation.add(base, Screened(NAME, vehicle, 0.0, "")))
    scored = judge.score(NAME, found, cost)
    weights = {
        key.rpartition(".")[2]: value
        for key, value in found.theta.items()
        if key.startswith(f"effects.{NAME}.") and key.rpartition(".")[2] not in LearnedResidual.known
    }
    facts = {
        "helps": scored.clear,
        "explained": float(np.clip(scored.explained, -1.0, 1.0)),
        "by_stage": {
            name: {"before": float(cost[name].sum()), "after": float(part.sum()), "noise": investigation.floor[name]}
            for name, part in scored.cost.items()
        },
        "weights": weights,
        "beside": list(decision.chosen),
    }
    return facts, found
