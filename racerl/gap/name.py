"""Naming the missing effect: score the catalogue, refit the shortlist, decide on runs that no fit has seen.

Round by round the effect that helps most on held-out windows is added, until none helps significantly. Effects that the
data can't tell from the best one are its rivals: those whose held-out costs are not significantly worse.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from racerl.gap.investigation import Found, Investigation

Array = NDArray[np.float64]
CONTINUED, SHORTLIST = 8, 5  # candidates that are fitted to the end, and that are judged on held-out runs
CLOSE = 0.3  # of the best gain, below which a candidate is no rival
ROUNDS = 3
RESAMPLES = 2000
SIGNIFICANT = 0.005  # p below which an effect helps
RIVAL = 0.05  # p above which a candidate is not significantly worse than the best
WILD = 30.0  # mean squared deviation of a window beyond which its size says nothing more
WORTH = 0.03  # share of the excess cost that an effect must explain


@dataclass(frozen=True)
class Scored:
    """A candidate on held-out windows: its fit, gain per window and stage, and the chance that it does not help."""

    name: str
    found: Found
    cost: dict[str, Array]
    gain: float
    p: float


@dataclass
class Decision:
    """What naming came to."""

    chosen: list[str]
    found: Found
    rounds: list[list[Scored]]
    rivals: dict[str, list[str]] = field(default_factory=dict)
    excess: list[float] = field(default_factory=list)  # of the cost over the noise, before each round and at the end


def name_effects(
    investigation: Investigation, seed: int, on_progress: Callable[[str, float], None] = lambda what, share: None
) -> Decision:
    """Return the effects that held-out runs ask for, with their rivals."""
    generator = np.random.default_rng(seed)
    current = investigation.base
    current_cost = investigation.held_out(current)
    decision = Decision([], current, [], excess=[excess(investigation, current_cost)])
    for number in range(ROUNDS):
        score = investigation.score(current).gains()
        hopeful = sorted((name for name in score if name not in decision.chosen), key=lambda name: -score[name])
        refined = []
        for i, name in enumerate(hopeful[:CONTINUED]):
            on_progress(f"round {number + 1}: {name}", (number + i / CONTINUED) / ROUNDS)
            vehicle = investigation.screen(current, name)
            if vehicle is not None:
                refined.append((name, investigation.add(current, vehicle)))
        gains = [investigation.gain(current, found) for _, found in refined]
        near = sorted(zip(gains, refined, strict=True), key=lambda row: -row[0])[:SHORTLIST]
        scored = [
            _score(investigation, name, found, current_cost, generator)
            for gain, (name, found) in near
            if gain > CLOSE * near[0][0]
        ]
        scored.sort(key=lambda row: -row.gain)
        decision.rounds.append(scored)
        best = scored[0] if scored else None
        if best is None or best.p > SIGNIFICANT or worth(investigation, current_cost, best) < WORTH:
            break
        decision.rivals[best.name] = [
            other.name for other in scored[1:] if _not_worse(investigation, best, other, current_cost, generator)
        ]
        decision.chosen.append(best.name)
        current = decision.found = best.found
        current_cost = {**current_cost, **best.cost}
        decision.excess.append(excess(investigation, current_cost))
    return decision


def excess(investigation: Investigation, cost: Mapping[str, Array]) -> float:
    """Return the cost beyond what the channels' noise alone would leave."""
    total = 0.0
    for name, part in cost.items():
        share = (investigation.noise[name] / investigation.sigma[name]) ** 2
        numbers = investigation.evidence[name].length + 1
        bounded = np.minimum(part, WILD * numbers * len(share))
        total += float(bounded.sum()) - float(share.sum()) * len(part) * numbers
    return total


def worth(investigation: Investigation, before: Mapping[str, Array], scored: "Scored") -> float:
    """Return the share of the excess cost that a candidate explains on held-out windows."""
    excess_before = excess(investigation, before)
    return (excess_before - excess(investigation, {**before, **scored.cost})) / max(excess_before, 1e-9)


def loss(investigation: Investigation, stage: str, cost: Array) -> Array:
    """Return n log(1 + cost/n) of every window's n numbers: a window that no fit foresaw does not decide alone."""
    evidence = investigation.evidence[stage]
    n = len(evidence.observed) * (evidence.length + 1)
    return n * np.log1p(cost / n)


def _score(
    investigation: Investigation,
    name: str,
    found: Found,
    before: Mapping[str, Array],
    generator: np.random.Generator,
) -> Scored:
    cost = investigation.held_out(found)
    gains = {
        stage: loss(investigation, stage, before[stage]) - loss(investigation, stage, part)
        for stage, part in cost.items()
    }
    total = float(sum(part.sum() for part in gains.values()))
    return Scored(name, found, cost, total, _chance(investigation, gains, generator))


def _chance(investigation: Investigation, gains: Mapping[str, Array], generator: np.random.Generator) -> float:
    """Return the share of block-bootstrap resamples in which the gains' sum is not positive."""
    total = np.zeros(RESAMPLES)
    for stage, part in gains.items():
        block = blocks(investigation, stage)
        sums = np.bincount(block, part)
        drawn = generator.integers(len(sums), size=(RESAMPLES, len(sums)))
        total += sums[drawn].sum(axis=1)
    return float((total <= 0.0).mean())


def blocks(investigation: Investigation, stage: str) -> NDArray[np.int64]:
    """Return a block number per window: four neighbours of one run."""
    evidence = investigation.evidence[stage]
    _, block = np.unique(evidence.run * 1_000_000 + evidence.start // (4 * evidence.length), return_inverse=True)
    return block


def _not_worse(
    investigation: Investigation,
    best: Scored,
    other: Scored,
    before: Mapping[str, Array],
    generator: np.random.Generator,
) -> bool:
    stages = {*best.cost, *other.cost}
    behind = {
        stage: loss(investigation, stage, other.cost.get(stage, before[stage]))
        - loss(investigation, stage, best.cost.get(stage, before[stage]))
        for stage in stages
    }
    return _chance(investigation, behind, generator) > RIVAL
