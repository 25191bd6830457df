"""The verdict: what held-out windows allow to be said of a log.

none            nothing is left beyond the sensors' noise, or of the motion beyond what clean cars with other tyres or
                sensors leave, and the log would have shown the usual effects
under_excited   nothing is left, but the log would not have shown most of them; or a small excess is explained too
                little to be sure of a name
named           one effect is needed, and no other explains the data as well
multiple        several effects, each needed beside the others
ambiguous       another effect explains the data as well, or hardly less where much stays that none explains
unknown         what is left is real, where effects that were found act, and no known effect explains it
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from racerl.gap.comparison import BEHIND, CLEAR, FOREIGN, REAL, WORSE, CandidateScore, close, equals, excesses, total
from racerl.gap.decision import Decision
from racerl.gap.fitted_model import touched
from racerl.gap.hypotheses import calibrated, unlisted
from racerl.gap.investigation import Investigation
from racerl.gap.score import Score
from racerl.gap.sentences import listed
from racerl.gap.shapes import WORDS
from racerl.gap.stage import TYRES

Costs = Mapping[str, float]  # excess of every stage
CHANCE = 5.0  # deviations of the noise's own cost, below which an excess may be chance
LEFT, LEFT_EXACT = 0.25, 0.1  # shares of the first excess that may stay behind a right name: of many forms, of one
EVEN = 0.5  # probability of something of no catalogue, below which an excess of the motion is no gap
CREDIBLE = 0.6  # share of the excess that a name must explain
MANY = 10.0  # times the noise's cost, from which on an excess is told in these
COARSE = 30.0  # excess over the noise's cost, beyond which that of filtered sensors is no yardstick
TWINS = 0.95  # |cosine| above which a linear test cannot tell two effects apart
MOST = 0.5  # share of the catalogue that a log must be able to show
NEAR = 2.0  # times the noise, up to which a fold that is told little decides whether an error grows
CLAIMS = ("named", "multiple", "ambiguous")
STABLE, RARE = 0.8, 0.1  # shares of resamples in which a name comes out, and a rival in its place at least


@dataclass(frozen=True)
class Verdict:
    """What is said: the kind, the effects, and those that cannot be told from one of them."""

    kind: str
    effects: tuple[str, ...]
    rivals: tuple[str, ...]
    blind: tuple[str, ...]  # effects that the log would not show at their usual size
    reason: str


def judge(investigation: Investigation, decision: Decision) -> Verdict:
    """Return the verdict."""
    before, after = fitted(investigation, decision)
    if not decision.chosen:
        return _without_effects(investigation, decision, before, after)
    return _with_effects(investigation, decision, before, after)


def _without_effects(investigation: Investigation, decision: Decision, before: Costs, after: Costs) -> Verdict:
    blind = decision.score.hidden()
    excused = [TYRES] if unlisted(decision.features, calibrated()) < EVEN else []
    asked = [name for name in decision.noise if name not in excused]
    stage, _, first = open_stage(investigation, decision, before, after, asked)
    if stage:
        return Verdict("unknown", (), (), blind, _unexplained(investigation, decision, stage, first))
    if len(blind) > MOST * len(decision.score.names):
        reason = f"{len(blind)} of {len(decision.score.names)} effects would not show at their usual size"
        return Verdict("under_excited", (), (), blind, reason)
    shapes = listed([WORDS[name] for name in investigation.shapes])
    reason = f"with {shapes}, " if shapes else ""
    stage, _, first = open_stage(investigation, decision, before, after, excused)
    if stage:
        left = f"an excess of {_noises(first)}"
        reason += f"the refitted vehicle leaves {left}, as clean cars with other tyres or sensors do"
    elif investigation.shaped:
        reason += f"the refitted vehicle comes within {FOREIGN:.0%} of the sensors' noise"
    else:
        reason += "the refitted vehicle reaches the noise"
    return Verdict("none", (), (), blind, reason)


def _unexplained(investigation: Investigation, decision: Decision, stage: str, first: float) -> str:
    """Return why a stage's excess has no name, and what would take a part of it."""
    reason = f"the {stage} stage has an excess of {_noises(first)}, which no effect explains"
    if decision.doubted:
        if stage in _doubted_in(investigation, decision):
            part = f"{decision.doubted} would take {decision.rounds[-1][0].explained:.0%} of it"
            reason += f"; {part}, but something that is not in the catalogue is more probable"
    elif best := _unclear(investigation, decision, stage):
        part = f"{best.name} would take {best.explained:.0%} of it, by {best.gain / best.error:.1f} standard errors"
        reason += f"; {part}, and a name takes {CLEAR:.0f}"
    return reason


def _noises(excess: float) -> str:
    return f"{excess:.0%} over the noise's cost" if excess < MANY else f"{excess:.0f} times the noise's cost"


def _unclear(investigation: Investigation, decision: Decision, stage: str) -> CandidateScore | None:
    """Return what came first in the last round, if it acts in a stage and explains much, though not clearly."""
    first = next(iter(decision.rounds[-1] if decision.rounds else []), None)
    if first is None or first.clear or first.explained < LEFT or first.gain <= 0.0:
        return None
    return first if stage in touched(investigation, first.found.vehicle, [first.name]) else None


def _with_effects(investigation: Investigation, decision: Decision, before: Costs, after: Costs) -> Verdict:
    effects, blind = tuple(decision.chosen), decision.score.hidden()
    unknown = partial(Verdict, "unknown", effects, (), blind)
    moved = touched(investigation, decision.found.vehicle, effects)
    stage, left, first = open_stage(investigation, decision, before, after, moved)
    if stage:
        return unknown(f"with {listed(effects)}, {left / first:.0%} of the excess in the {stage} stage stays")
    had, rest = (total(parts[stage] for stage in moved) for parts in (before, after))
    explain = f"{listed(effects)} {'explains' if len(effects) == 1 else 'explain'}"
    if rest >= had:
        return unknown(f"{explain} nothing of the excess")
    share, noise = 1.0 - rest / had, sum(decision.noise[stage] for stage in moved)
    explained = f"{explain} {share:.0%} of the excess"
    if decision.doubted and set(_doubted_in(investigation, decision)) & set(moved):
        like = f"something else is missing that resembles {decision.doubted} but probably is not {decision.doubted}"
        return unknown(f"{explained}; {like}")
    elsewhere = [name for name in decision.noise if name not in moved]  # where these effects do not act
    stage, left, _ = open_stage(investigation, decision, before, after, elsewhere)
    if stage:
        explained += f"; in the {stage} stage an excess of {_noises(left)} stays without a name"
    real = sum(_real(investigation, stage) * decision.noise[stage] for stage in moved)
    foreign = investigation.shaped and TYRES in moved and rest < real
    coarse = any(_coarse(investigation, decision, stage, after[stage]) for stage in moved)
    if share < CREDIBLE and not foreign and not coarse:
        return Verdict("under_excited", (), (), blind, f"{explain} only {share:.0%} of a small excess")
    if had < REAL * noise:
        explained += ", which is within the uncertainty of the noise level"
    stays = 0.0 if share >= CREDIBLE or foreign else 1.0 - share
    if rivals := _rivals(decision, effects, stays):
        return Verdict("ambiguous", effects, tuple(rivals), blind, "; ".join([explained, *rivals.values()]))
    return Verdict("named" if len(effects) == 1 else "multiple", effects, (), blind, explained)


def _doubted_in(investigation: Investigation, decision: Decision) -> list[str]:
    """Return the stages in which the effect in doubt acts."""
    return touched(investigation, decision.rounds[-1][0].found.vehicle, [decision.doubted])


def _rivals(decision: Decision, effects: Collection[str], stays: float) -> dict[str, str]:
    """Return the effects that may stand in the place of one that was found, and what speaks for each.

    Where a share of the excess `stays`, what explains more may do so by chance: what is needed and close is a rival.
    """
    equal = [row.name for rows in decision.kept.values() for row in equals(rows)]
    told = {name: f"{name} explains it as well" for name in (*equal, *_one_with(decision))}
    for row in (row for rows in decision.kept.values() for row in _unsettled(rows)):
        told.setdefault(row.name, f"in {row.leads:.0%} of resamples {row.name} comes first instead")
    for rows in decision.kept.values() if stays else ():
        for row in (row for row in rows[1:] if row.needed and close(row, rows[0])):
            behind = f"only {max(row.behind, 0.0):.1f} standard errors behind, where {stays:.0%} stays unexplained"
            told.setdefault(row.name, f"{row.name} is {behind}")
    return {name: said for name, said in told.items() if name not in effects}


def proved(verdict: Verdict, gap: Mapping[str, float]) -> Verdict:
    """Return the verdict; `unknown` where with the effects that it names the error in held-out windows grows.

    They help in many windows then, which a judgement by robust losses counts, and spoil others.
    """
    if verdict.kind not in CLAIMS or gap["after"] <= max(NEAR, WORSE * gap["before"]):
        return verdict
    helps = "helps" if len(verdict.effects) == 1 else "help"
    grows = f"grows from {gap['before']:.2f} to {gap['after']:.2f} times the sensors' noise"
    reason = f"{listed(verdict.effects)} {helps} in many stretches, but the error {grows}"
    return replace(verdict, kind="unknown", rivals=(), reason=reason)


def _one_with(decision: Decision) -> list[str]:
    """Return the rivals that are one with a chosen effect in this log, even where their fits ended apart."""
    one = decision.score.one
    return [
        row.name
        for name, rows in decision.kept.items()
        for row in rows[1:]
        if row.behind < BEHIND and one(name, row.name)
    ]


def _unsettled(rows: Sequence[CandidateScore]) -> list[CandidateScore]:
    """Return the candidates that come out in place of an effect that does so in too few resamples, if any does."""
    if rows[0].leads >= STABLE:
        return []
    instead = sorted((row for row in rows[1:] if row.leads > 0.0), key=lambda row: -row.leads)
    return [row for row in instead if row.leads >= RARE] or instead[:1]


def open_stage(
    investigation: Investigation, decision: Decision, before: Costs, after: Costs, among: Collection[str] | None = None
) -> tuple[str, float, float]:
    """Return the stage, `among` some or all, whose excess is real and not explained most of all.

    With it come that excess and its first one, over the noise's cost.
    """
    worst = ("", 0.0, 0.0)
    for name, noise in decision.noise.items():
        if among is not None and name not in among:
            continue
        left, first = after[name] / noise, before[name] / noise
        real = max(_real(investigation, name), CHANCE * investigation.chance[name])
        if decision.chosen and _coarse(investigation, decision, name, after[name]):
            continue
        if left > real + _may_stay(investigation, decision, name) * first and left > worst[1]:
            worst = (name, left, first)
    return worst


def _real(investigation: Investigation, stage: str) -> float:
    """Return the excess over the noise's cost beyond which it is real; tyres of another formula leave more."""
    return FOREIGN if investigation.shaped and stage == TYRES else REAL


def _may_stay(investigation: Investigation, decision: Decision, stage: str) -> float:
    """Return which share of a stage's excess may stay behind right names; none where they do not act."""
    vehicle = decision.found.vehicle
    acting = [name for name in decision.chosen if stage in touched(investigation, vehicle, [name])]
    if not acting:
        return 0.0
    return LEFT_EXACT if all(vehicle.effects[name].exact for name in acting) else LEFT


def _coarse(investigation: Investigation, decision: Decision, stage: str, left: float) -> bool:
    """Return whether what is left in a stage cannot be measured in noise: real cars, sensors that were filtered."""
    return left > COARSE * decision.noise[stage] and investigation.evidence[stage].filtered


def fitted(investigation: Investigation, decision: Decision) -> tuple[dict[str, float], dict[str, float]]:
    """Return the excess of every stage before and after naming, by the fits to all windows.

    On short logs, parameters that a fold knows badly look like an excess on held-out windows.
    """
    base = investigation.base.cost
    costs = base, {**base, **decision.found.cost}
    before, after = (excesses(investigation, cost, decision.noise) for cost in costs)
    return before, after


def separable(score: Score) -> tuple[str, ...]:
    """Return the effects that would show at their usual size and look like no other that does."""
    dark, twins = score.hidden(), alike(score)
    return tuple(name for name, row in zip(score.names, twins, strict=True) if name not in dark and not row.any())


def alike(score: Score) -> NDArray[np.bool_]:
    """Return which effects that would show a linear test cannot tell from each other, (E, E)."""
    dark = score.hidden()
    shown = np.array([name not in dark for name in score.names])
    same: NDArray[np.bool_] = np.abs(score.cosines()) > TWINS
    return same & np.outer(shown, shown) & ~np.eye(len(shown), dtype=bool)
