"""What is offered where no known effect explains the gap: a bounded residual that is learned like any effect.

First a regression over a few terms, of which those stay whose weights are clearly off zero. Then a small network
beside them, which stays if it helps on held-out windows. Weights have a prior around where they start, zero for all
that makes a force, so that what the data do not ask for stays small; both fade outside of what the log has seen; and
they have no physical name.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from racerl.gap.candidates import add, again, converged
from racerl.gap.comparison import WORTH, CandidateScore, Judge, Standing, excess
from racerl.gap.cross_validation import held_out
from racerl.gap.fitted_model import FittedModel, with_effect
from racerl.gap.investigation import Investigation
from racerl.gap.progress import OnProgress, silent
from racerl.gap.uncertainty import deviations
from racerl.vehicle.effects import Effect
from racerl.vehicle.effects._fading import Fading
from racerl.vehicle.effects.learned_network import LearnedNetwork
from racerl.vehicle.effects.learned_residual import LearnedResidual

TERMS, NETWORK = "learned_residual", "learned_network"
CHANNELS = {"speed": ("v_x", "omega"), "steering": ("delta", "delta_ref"), "yaw_rate": ("yaw_rate",)}
SEEN = 0.995  # quantile that counts as the greatest value seen
SURE = 2.0  # deviations that a term's weight is off zero


def limits(investigation: Investigation) -> dict[str, float]:
    """Return the limits of what the logs show."""
    columns: Mapping[str, Any] = next(iter(investigation.evidence.values())).columns
    seen = {}
    for key, names in CHANNELS.items():
        channel = next((name for name in names if np.any(columns.get(name, 0.0))), None)  # zeros stand for none
        if channel:
            seen[key] = max(float(np.quantile(np.abs(columns[channel]), SEEN)), 0.1)
    return seen


def learn(investigation: Investigation, on_progress: OnProgress = silent) -> tuple[dict[str, Any], FittedModel]:
    """Fit terms, then a network, to what the refitted vehicle leaves; return what they explain, and the fit."""
    seen, base = limits(investigation), investigation.base
    terms, network = LearnedResidual(**seen), LearnedNetwork(**seen)
    on_progress("learning a residual: terms", 0.0)
    knowing = investigation.knowing({TERMS: [terms]})
    judge = Judge(knowing, held_out(knowing, base))
    knowing, found = sparse(knowing, _with(knowing, base, TERMS, terms))
    scored = replace(judge, investigation=knowing).score(
        TERMS, found, Standing(base, dict(judge.first), dict(knowing.floor))
    )
    steps = [_step(judge, scored, found, scored.clear)]
    if scored.clear:
        on_progress("learning a residual: a network", 0.5)
        knowing = knowing.knowing({TERMS: [terms], NETWORK: [network]})
        more = _with(knowing, found, NETWORK, network)
        standing = Standing(found, {**judge.first, **scored.cost}, dict(knowing.floor))
        scored = replace(judge, investigation=knowing).score(NETWORK, more, standing)
        kept = scored.clear and scored.worth > WORTH
        steps.append(_step(judge, scored, more, kept))
        found = more if kept else found
    facts = {
        "effects": [step["name"] for step in steps if step["kept"]],
        "steps": steps,
        "by_stage": {
            name: {"before": float(part.sum()), "noise": investigation.floor[name]}
            for name, part in judge.first.items()
        },
    }
    return facts, found


def sparse(investigation: Investigation, found: FittedModel) -> tuple[Investigation, FittedModel]:
    """Take out the weaker half of the terms that may as well be zero, fit the others again, until none is idle."""
    while True:
        known = deviations(investigation, found)
        sure = {n: abs(weight) / max(known[n], 1e-12) for n, weight in weights(found, TERMS).items() if weight}
        idle = sorted((n for n in sure if sure[n] < SURE), key=lambda n: sure[n])
        if not idle:
            return investigation, found
        weaker = idle[: (len(idle) + 1) // 2]  # terms that look alike are not all thrown out at once
        investigation = investigation.limited(dict.fromkeys(weaker, (0.0, 0.0)))
        found = again(investigation, found, dict.fromkeys(weaker, 0.0))


def weights(found: FittedModel, effect: str) -> dict[str, float]:
    """Return a learned effect's weights by dotted name."""
    known = Fading.known
    mine = {name: value for name, value in found.theta.items() if name.startswith(f"effects.{effect}.")}
    return {name: value for name, value in mine.items() if name.rpartition(".")[2] not in known}


def _with(investigation: Investigation, base: FittedModel, name: str, effect: Effect) -> FittedModel:
    """Return the fit with a learned effect more, carried on to its end."""
    return converged(investigation, add(investigation, base, name, with_effect(base.vehicle, name, effect)))


def _step(judge: Judge, scored: CandidateScore, found: FittedModel, kept: bool) -> dict[str, Any]:
    """Return what was learned in a step, and the share of the first excess that is gone after it."""
    costs, noise = (judge.first, {**judge.first, **scored.cost}), judge.investigation.floor
    first, left = (excess(judge.investigation, cost, noise) for cost in costs)
    return {
        "name": scored.name,
        "kept": kept,
        "explained": float(np.clip(1.0 - left / max(first, 1e-9), -1.0, 1.0)),
        "after": {stage: float(part.sum()) for stage, part in scored.cost.items()},
        "weights": {key.rpartition(".")[2]: value for key, value in weights(found, scored.name).items() if value},
    }
