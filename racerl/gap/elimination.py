"""Backward elimination: every effect is judged again beside those found after it.

What they make needless is taken out, and a rival that now explains more takes its place. At last everything is
identified again, and an effect goes whose interval then holds the value of no effect, or all of the floor as its place.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from racerl.gap.candidates import add, everywhere, joined, without
from racerl.gap.catalogue import PLACE, neutral, placed
from racerl.gap.comparison import STAYS, CandidateScore, Judge, close
from racerl.gap.decision import Decision, carried, changed, passes_less_noise
from racerl.gap.evidence import Evidence
from racerl.gap.features import features
from racerl.gap.fitted_model import FittedModel
from racerl.gap.progress import OnProgress, silent
from racerl.gap.uncertainty import intervals
from racerl.vehicle import catalogue

Rows = Mapping[str, Sequence[CandidateScore]]  # every effect, and its rivals


def eliminated(judge: Judge, decision: Decision, on_progress: OnProgress = silent) -> Decision:
    """Judge every effect again beside the others; the last one found is judged so already, unless others change."""
    found = decision.chosen
    for i, name in enumerate(found[:-1]):
        on_progress(f"{name} again", 0.5 * i / len(found))
        decision = _judged_again(judge, decision, name)
    if decision.chosen != found:
        for i, name in enumerate(decision.chosen):
            on_progress(f"{name} again", 0.5 + 0.5 * i / len(found))
            decision = _judged_again(judge, decision, name)
    return decision


def _judged_again(judge: Judge, decision: Decision, name: str) -> Decision:
    """Judge an effect beside the others, and its rivals in its place: it stays, goes, or is exchanged."""
    investigation = judge.investigation
    less = carried(investigation, without(investigation, decision.found, name))
    others = {other: rows for other, rows in decision.kept.items() if other != name}
    lacking = changed(investigation, decision, others, less)
    own = judge.score(name, decision.found, lacking)
    if not own.stays:
        return lacking
    first, *rest = decision.kept[name]
    same = [row for row in rest if judge.one(first, row)]  # fits of one model: what holds for one holds for all
    near = [row for row in rest if close(row, first) and row.name not in others and row not in same]
    rivals = investigation.workers.each(lambda row: _instead(judge, lacking, row), near)
    rows = judge.ranked([own, *_sound(judge, lacking, rivals)], lacking.cost)
    if rows[0].name == name:
        rows[1:1] = [replace(rows[0], name=row.name) for row in same]
    kept = dict((rows[0].name, rows) if other == name else (other, kept) for other, kept in decision.kept.items())
    if rows[0].name == name:
        return replace(decision, kept=kept)
    return changed(investigation, decision, kept, rows[0].found)


def _instead(judge: Judge, lacking: Decision, rival: CandidateScore) -> CandidateScore:
    """Return a rival of an effect, fitted and judged beside all others."""
    investigation, effect = judge.investigation, rival.found.vehicle.effects[rival.name]
    vehicle = joined(investigation, lacking.found.vehicle, rival.name, effect)
    found = add(investigation, lacking.found, rival.name, vehicle)
    return judge.score(rival.name, carried(investigation, found), lacking)


def settled(judge: Judge, decision: Decision) -> Decision:
    """Identify everything again in all stages; take out effects whose interval then holds no effect, or any place.

    Without any effect the refit stands as it was.
    Rivals that are needed without them take their places: a bowl of which nobody knows where it is is a tilted floor.
    """
    investigation = judge.investigation
    while True:
        found = everywhere(investigation, decision.found) if decision.chosen else investigation.base
        ranges = intervals(investigation, found)
        idle = [
            name for name in decision.chosen if _idle(name, ranges) or _nowhere(name, ranges, investigation.evidence)
        ]
        if not idle:
            kept = {name: _somewhere(judge, decision, rows) for name, rows in decision.kept.items()}
            seen = [_nameable(each, decision.kept, kept) for each in _as_kept(decision.features, kept)]
            return replace(decision, found=found, kept=kept, features=seen)
        decision = _without(judge, decision, idle[0], without(investigation, found, idle[0]))


def _without(judge: Judge, decision: Decision, name: str, less: FittedModel) -> Decision:
    """Return the decision, whose fit is `less`, without an effect; a rival of its round that is needed follows it."""
    investigation = judge.investigation
    others = {other: rows for other, rows in decision.kept.items() if other != name}
    lacking = changed(investigation, decision, others, less)
    own = {row.name: row for rows in decision.rounds for row in rows}  # a rival that is one with it has its fit
    asked = [own[row.name] for row in decision.kept[name][1:] if row.needed and row.name not in others]
    rivals = investigation.workers.each(lambda row: _instead(judge, lacking, row), asked)
    rows = judge.ranked(_sound(judge, lacking, rivals), lacking.cost)
    if not rows:
        return lacking
    followed = replace(decision, features=_passed_on(decision.features, name, features(judge, lacking, rows)))
    return changed(investigation, followed, {**others, rows[0].name: rows}, rows[0].found)


def _passed_on(seen: Sequence[Mapping[str, Any]], name: str, follows: dict[str, Any]) -> list[dict[str, Any]]:
    """Return what rounds saw, with the one that found an effect as it `follows` without.

    An effect that came in the place of another was found in no round.
    """
    return [follows if _first(each) == name else dict(each) for each in seen]


def _as_kept(seen: Sequence[Mapping[str, Any]], kept: Collection[str]) -> list[dict[str, Any]]:
    """Return what rounds saw, of all but the last only those that found an effect which is kept.

    A rival in its place comes first, and not again later. The round behind one that is left out begins with its excess.
    """
    found: list[dict[str, Any]] = []
    first, added = {_first(each) for each in seen[:-1]}, set()
    begun: dict[str, Any] = {}
    for each in seen:
        rows = [row for row in each["candidates"] if row["name"] not in added]
        begun = {**each, **begun, "candidates": rows}
        own = [row for row in rows if row["name"] in kept and row["name"] not in first - {_first(each)}]
        if each is seen[-1]:
            found.append(begun)
        elif own:
            found.append({**begun, "candidates": [own[0], *(row for row in rows if row is not own[0])]})
            added.add(own[0]["name"])
            begun = {}
    return found


def _nameable(each: Mapping[str, Any], rivals: Rows, kept: Rows) -> dict[str, Any]:
    """Return what a round saw, without the rivals of its effect that are not `kept`, and with resamples as there."""
    name = _first(each)
    leads = {row.name: row.leads for row in kept.get(name, [])}
    gone = {row.name for row in rivals.get(name, [])} - set(leads)
    if not gone:
        return dict(each)
    rows = [row for row in each["candidates"] if row["name"] not in gone]
    return {**each, "candidates": [{**row, "leads": leads.get(row["name"], row["leads"])} for row in rows]}


def _first(each: Mapping[str, Any]) -> str:
    return each["candidates"][0]["name"] if each["candidates"] else ""


def _sound(judge: Judge, lacking: Decision, rivals: Sequence[CandidateScore]) -> list[CandidateScore]:
    """Return the rivals that held-out windows ask for, by what they know of the car."""
    return [rival for rival in rivals if rival.stays and not passes_less_noise(judge, lacking, rival, STAYS)]


def _somewhere(judge: Judge, decision: Decision, rows: Sequence[CandidateScore]) -> list[CandidateScore]:
    """Return an effect and those rivals that, where they have a place, have it on the floor: no other could be named.

    Resamples in which another rival came first count no more.
    """
    investigation, own = judge.investigation, {row.name: row.found for found in decision.rounds for row in found}

    def far_away(rival: CandidateScore) -> bool:
        name = rival.name
        return placed(name) and _nowhere(name, intervals(investigation, own[name]), investigation.evidence)

    gone = [rival for rival in rows[1:] if far_away(rival)]
    left = 1.0 - sum(row.leads for row in gone if not judge.one(rows[0], row))
    kept = [row for row in rows if row not in gone]
    if left <= 0.0:  # none of these ever came first
        return [replace(row, leads=float(row is rows[0])) for row in kept]
    return [replace(row, leads=min(row.leads / left, 1.0)) for row in kept]


def _idle(name: str, ranges: Mapping[str, tuple[float, float, float]]) -> bool:
    """Return whether the intervals of all parameters that vanish without the effect, or have no bound, hold that."""
    entry, (_, zero) = catalogue.entry(name), neutral(name)
    if unbounded := entry.cls.unbounded:
        limits = [(*ranges[f"effects.{name}.{key}"], entry.parameters[key].high) for key in unbounded]
        return all(high >= min(2.0 * value, bound) for value, _, high, bound in limits)  # of 1/value holds 0
    known = [ranges[f"effects.{name}.{key}"] for key in list(entry.parameters)[: entry.cls.vanishing]]
    return bool(known) and all(low <= zero <= high for _, low, high in known)


def _nowhere(name: str, ranges: Mapping[str, tuple[float, float, float]], evidence: Mapping[str, Evidence]) -> bool:
    """Return whether the interval of an effect's place is as wide as the floor that was driven on."""
    if not placed(name):
        return False
    known = {axis: ranges[f"effects.{name}.{axis}"] for axis in PLACE}
    return any(high - low >= np.ptp(evidence["chassis"].columns[axis]) for axis, (_, low, high) in known.items())
