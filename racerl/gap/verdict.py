"""The verdict: what held-out windows allow to be said of a log.

none            nothing is left beyond the sensors' noise, and the log would have shown the usual effects
under_excited   nothing is left, but the log would not have shown most of them; or a small excess is explained too
                little to be sure of a name
named           one effect is needed, and no other explains the data as well
multiple        several effects, each needed beside the others
ambiguous       another effect explains the data as well
unknown         what is left is real, and no known effect explains it
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from racerl.gap.investigation import Investigation
from racerl.gap.name import PARAMETER, Decision, Scored, excesses
from racerl.gap.score import Score

REAL = 0.05  # excess cost over the noise's that is real: the noise itself is known to a few percent
CHANCE = 5.0  # deviations of the noise's own cost, a χ², below which an excess may be chance
LEFT = 0.25  # share of the first excess that may stay behind when the name is right
CREDIBLE = 0.6  # share of the excess that a name must explain
COARSE = 30.0  # excess over the noise's cost, beyond which noise is no yardstick: a real car, smoothed sensors
ALIKE = 3.0  # standard errors that a rival may be behind
EQUAL = 0.05  # share of the excess that a rival may explain less
SHOWS = 30.0  # first-order gain, a χ², at its usual size that makes an effect show
TWINS = 0.95  # |cosine| above which a linear test cannot tell two effects apart
MOST = 0.5  # share of the catalogue that a log must be able to show


@dataclass(frozen=True)
class Verdict:
    """What is said: the kind, the effects, and those that cannot be told from the first."""

    kind: str
    effects: tuple[str, ...]
    rivals: tuple[str, ...]
    blind: tuple[str, ...]  # effects that the log would not show at their usual size
    reason: str


def judge(investigation: Investigation, decision: Decision) -> Verdict:
    """Return the verdict."""
    blind = hidden(decision.score)
    effects = tuple(decision.chosen)
    rivals = tuple(name for row in _rounds(decision) for name in equals(row) if name not in effects)
    before, after = fitted(investigation, decision)
    stage, left, first = open_stage(investigation, decision, before, after)
    if not effects:
        if stage:
            reason = f"the {stage} stage has an excess of {first:.0%} over the noise's cost, which no effect explains"
            return Verdict("unknown", (), (), blind, reason)
        if len(blind) > MOST * len(decision.score.names):
            reason = f"{len(blind)} of {len(decision.score.names)} effects would not show at their usual size"
            return Verdict("under_excited", (), (), blind, reason)
        return Verdict("none", (), (), blind, "the refitted vehicle reaches the noise")
    if stage:
        reason = f"{' and '.join(effects)} helps, but leaves {left / first:.0%} of the excess in the {stage} stage"
        return Verdict("unknown", effects, (), blind, reason)
    touched = investigation.touched(decision.found.vehicle, frozenset(effects))  # elsewhere an excess is chance
    total, rest = (sum(max(0.0, parts[stage]) for stage in touched) for parts in (before, after))
    share = 1.0 - rest / max(total, 1e-9)
    coarse = rest > COARSE * sum(investigation.floor.values())
    if not coarse and share < CREDIBLE:
        reason = f"{' and '.join(effects)} helps, but explains only {share:.0%} of a small excess"
        return Verdict("under_excited", (), (), blind, reason)
    explained = f"{' and '.join(effects)} explains {share:.0%} of the excess"
    if rivals:
        return Verdict("ambiguous", effects, rivals, blind, f"{explained}, and so does {' or '.join(rivals)}")
    return Verdict("named" if len(effects) == 1 else "multiple", effects, (), blind, explained)


def open_stage(
    investigation: Investigation, decision: Decision, before: Mapping[str, float], after: Mapping[str, float]
) -> tuple[str, float, float]:
    """Return the stage whose excess is real and not explained, with that and its first one, over the noise's cost."""
    worst = ("", 0.0, 0.0)
    for name, noise in investigation.floor.items():
        left, first = after[name] / noise, before[name] / noise
        coarse = decision.chosen and left > COARSE
        real = max(REAL, CHANCE * np.sqrt(2.0 / counted(investigation, name)))
        if left > real and left > LEFT * first and not coarse and left > worst[1]:
            worst = (name, left, first)
    return worst


def counted(investigation: Investigation, stage: str) -> int:
    """Return how many numbers a stage compares."""
    evidence = investigation.evidence[stage]
    return evidence.numbers * len(evidence.start)


def fitted(investigation: Investigation, decision: Decision) -> tuple[dict[str, float], dict[str, float]]:
    """Return the excess of every stage before and after naming, by the fits to all windows.

    On short logs, parameters that a fold knows badly look like an excess on held-out windows.
    """
    base = investigation.base.cost
    return excesses(investigation, base), excesses(investigation, {**base, **decision.found.cost})


def _rounds(decision: Decision) -> list[list[Scored]]:
    """Return the rounds whose best effect was kept."""
    return [row for row in decision.rounds if row and row[0].name in decision.chosen]


def equals(row: list[Scored]) -> list[str]:
    """Return the candidates of a round that explain the data as well as its best.

    More parameters have to explain more, or to foresee held-out windows better.
    """
    best = row[0]

    def equal(other: Scored) -> bool:
        slack = EQUAL if other.size <= best.size or other.behind < 0.0 else 0.0
        return other.explained - PARAMETER * other.size > best.explained - PARAMETER * best.size - slack

    return [other.name for other in row[1:] if other.clear and other.behind < ALIKE and equal(other)]


def hidden(score: Score) -> tuple[str, ...]:
    """Return the effects that would not show at their usual size."""
    shown = np.diag(score.H)
    return tuple(name for name, gain in zip(score.names, shown, strict=True) if gain < SHOWS)


def separable(score: Score) -> tuple[str, ...]:
    """Return the effects that would show at their usual size and look like no other that does."""
    dark, twins = hidden(score), alike(score)
    return tuple(name for name, row in zip(score.names, twins, strict=True) if name not in dark and not row.any())


def alike(score: Score) -> NDArray[np.bool_]:
    """Return which effects that would show a linear test cannot tell from each other, (E, E)."""
    dark = hidden(score)
    shown = np.array([name not in dark for name in score.names])
    same: NDArray[np.bool_] = np.abs(score.cosines()) > TWINS
    return same & np.outer(shown, shown) & ~np.eye(len(shown), dtype=bool)
