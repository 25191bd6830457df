"""Naming the missing effect: score the catalogue, refit the shortlist, decide on stretches that no fit has seen.

Round by round the effect that helps most on held-out windows is added, until none helps significantly; then every one
that is no longer needed beside the others is taken out again.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from racerl.gap.catalogue import placed
from racerl.gap.investigation import Found, Investigation

Array = NDArray[np.float64]
SHORTLIST, CONTINUED = 8, 4  # candidates that are screened, and that are fitted to the end
FAINT = 0.15  # of the most gain in screening, below which a candidate is given up
CLOSE = 0.5  # of the most gain, above which a candidate's fit is carried on to its end
HOPELESS = 30.0  # first-order gain, a χ², below which no effect is worth a fit
ROUNDS = 3
RESAMPLES = 2000
CLEAR = 3.0  # standard errors by which a gain must differ from zero
SAME = 2.0  # standard errors within which candidates explain alike
PARAMETER = 0.01  # share of the excess that one more parameter must explain
WILD = 30.0  # mean squared deviation of a window beyond which its size says nothing more
WORTH = 0.04  # share of the first excess, and of what is left of it before the round, that an effect must explain


@dataclass(frozen=True)
class Scored:
    """A candidate on held-out windows: its fit, its cost per window and stage, and what it gains.

    `gain` is in squared deviations, robust against wild windows, `error` its standard error over blocks of windows;
    `explained` the share of the excess before it that it takes away; `behind` is how much the round's best one gains
    beyond it, in standard errors of the difference.
    """

    name: str
    found: Found
    cost: dict[str, Array]
    gain: float
    error: float
    p: float
    explained: float
    behind: float = 0.0

    @property
    def size(self) -> int:
        """Number of the effect's own parameters."""
        return sum(name.startswith(f"effects.{self.name}.") for name in self.found.problem.names)

    @property
    def clear(self) -> bool:
        """Whether the gain differs from zero."""
        return self.gain > CLEAR * self.error


@dataclass
class Decision:
    """What naming came to: effects in the order found, every round's candidates, best first."""

    chosen: list[str]
    found: Found
    cost: dict[str, Array]
    rounds: list[list[Scored]] = field(default_factory=list)
    excess: list[float] = field(default_factory=list)  # of the cost over the noise, before each round and at the end


def name_effects(
    investigation: Investigation, seed: int, on_progress: Callable[[str, float], None] = lambda what, share: None
) -> Decision:
    """Return the effects that held-out windows ask for."""
    judge = Judge(investigation, np.random.default_rng(seed))
    base = investigation.base
    cost = investigation.held_out(base)
    decision = Decision([], base, cost, excess=[excess(investigation, cost)])
    for number in range(ROUNDS):
        scored = _round(judge, decision, _within(on_progress, number))
        decision.rounds.append(scored)
        if not scored or not scored[0].clear or not _worth(decision, scored[0]):
            break
        best = scored[0]
        decision.chosen.append(best.name)
        decision.found, decision.cost = best.found, {**decision.cost, **best.cost}
        decision.excess.append(excess(investigation, decision.cost))
    return _without_needless(judge, decision)


def _within(on_progress: Callable[[str, float], None], number: int) -> Callable[[str, float], None]:
    return lambda what, share: on_progress(what, (number + share) / ROUNDS)


def _worth(decision: Decision, best: Scored) -> bool:
    return best.explained > WORTH and best.explained * decision.excess[-1] > WORTH * decision.excess[0]


def _round(judge: "Judge", decision: Decision, on_progress: Callable[[str, float], None]) -> list[Scored]:
    """Return the candidates beside those chosen, on held-out windows, best first."""
    investigation, current = judge.investigation, decision.found
    gains = investigation.score(current).gains()
    promising = sorted((n for n in gains if n not in decision.chosen and gains[n] > HOPELESS), key=lambda n: -gains[n])
    shortlist = promising[:SHORTLIST]
    if shortlist and "chassis" in investigation.evidence:  # the score knows one place only
        shortlist += [n for n in gains if placed(n) and n not in (*shortlist, *decision.chosen)]
    tried = []
    for i, name in enumerate(shortlist):
        on_progress(name, i / len(shortlist))
        tried.append(investigation.screen(current, name))
    screened = sorted((each for each in tried if each is not None), key=lambda each: -each.gain)
    hopeful = [each for each in screened[:CONTINUED] if each.gain > FAINT * screened[0].gain]
    scored = [judge.score(each.name, investigation.add(current, each), decision.cost) for each in hopeful]
    most = max((row.gain for row in scored), default=0.0)
    near = [row.gain > max(CLOSE * most, CLEAR * row.error) for row in scored]
    scored = [
        judge.score(row.name, investigation.converged(row.found), decision.cost) if close else row
        for row, close in zip(scored, near, strict=True)
    ]
    scored.sort(key=lambda row: -row.gain)
    if scored:
        alike = [row for row in scored if judge.behind(scored[0], row, decision.cost) < SAME]
        first = max(alike, key=lambda row: row.explained - PARAMETER * row.size)
        scored = [first, *(row for row in scored if row is not first)]
    return [replace(row, behind=judge.behind(scored[0], row, decision.cost)) for row in scored]


def _without_needless(judge: "Judge", decision: Decision) -> Decision:
    """Take out effects that the others made needless."""
    for name in decision.chosen[:-1]:
        others = [other for other in decision.chosen if other != name]
        less = judge.investigation.without(decision.found, name)
        cost = {**decision.cost, **judge.investigation.held_out(less)}
        gain, error = judge.gain(cost, decision.cost)
        if gain < CLEAR * error or excess(judge.investigation, cost) - decision.excess[-1] < WORTH * decision.excess[0]:
            decision = replace(decision, chosen=others, found=less, cost=cost)
            decision.excess.append(excess(judge.investigation, cost))
    return decision


def excess(investigation: Investigation, cost: Mapping[str, Array]) -> float:
    """Return the cost beyond what the sensors' noise alone would leave; wild windows count up to a limit."""
    total = 0.0
    for name, part in cost.items():
        evidence = investigation.evidence[name]
        most = WILD * len(evidence.observed) * (evidence.length + 1)
        total += float(np.minimum(part, most).sum()) - investigation.floor[name]
    return total


@dataclass(frozen=True)
class Judge:
    """Judges fits by held-out costs, with block bootstrap."""

    investigation: Investigation
    generator: np.random.Generator

    def score(self, name: str, found: Found, before: Mapping[str, Array]) -> Scored:
        """Return a candidate's gain against the costs before it."""
        cost = self.investigation.held_out(found)
        gain, error = self.gain(before, cost)
        had = excess(self.investigation, before)
        least = 0.001 * sum(self.investigation.floor.values())  # an excess as small as this is noise itself
        share = (had - excess(self.investigation, {**before, **cost})) / max(had, least)
        return Scored(name, found, cost, gain, error, self.chance(before, cost), share)

    def behind(self, best: Scored, other: Scored, before: Mapping[str, Array]) -> float:
        """Return by how many standard errors a candidate is worse than the best."""
        if other is best:
            return 0.0
        gain, error = self.gain({**before, **other.cost}, {**before, **best.cost})
        return gain / max(error, 1e-9)

    def gain(self, before: Mapping[str, Array], after: Mapping[str, Array]) -> tuple[float, float]:
        """Return the fall of the loss over the stages in both, and its standard error over blocks of windows."""
        sums = self._blocks(before, after)
        total = float(sums.sum())
        return total, float(np.sqrt(((sums - total / max(len(sums), 1)) ** 2).sum()))

    def chance(self, before: Mapping[str, Array], after: Mapping[str, Array]) -> float:
        """Return the share of block-bootstrap resamples in which the loss does not fall."""
        sums = self._blocks(before, after)
        drawn = sums[self.generator.integers(len(sums), size=(RESAMPLES, len(sums)))].sum(axis=1)
        return float((drawn <= 0.0).mean())

    def _blocks(self, before: Mapping[str, Array], after: Mapping[str, Array]) -> Array:
        parts = []
        for stage in after:
            if stage in before:
                fall = self.loss(stage, before[stage]) - self.loss(stage, after[stage])
                parts.append(np.bincount(self.investigation.blocks(stage), fall))
        return np.concatenate(parts)

    def loss(self, stage: str, cost: Array) -> Array:
        """Return n log(1 + cost/n) of every window's n numbers: a window that no fit foresaw does not decide alone."""
        evidence = self.investigation.evidence[stage]
        n = len(evidence.observed) * (evidence.length + 1)
        return n * np.log1p(cost / n)
