"""Naming the missing effect: score the catalogue, fit the shortlist, decide on stretches that no fit has seen.

Round by round the effect that helps most on held-out windows is added, until none helps significantly, or simulated
cars say that rather none is missing; then backward elimination judges every one again beside those found after it.
Where a vehicle of another shape, a double track or tyres of another formula, helps more than any, naming begins anew
with that. What was fitted to its end before, in that naming or in an earlier round, is screened whatever first-order
theory says, and starts from where it ended, too.
"""

from collections.abc import Iterable, Mapping, Sequence

from racerl.gap.candidates import add, converged
from racerl.gap.comparison import CandidateScore, Judge, excess
from racerl.gap.cross_validation import held_out
from racerl.gap.decision import Decision, carried, changed, passes_less_noise
from racerl.gap.elimination import eliminated, settled
from racerl.gap.features import features
from racerl.gap.fitted_model import FittedModel
from racerl.gap.hypotheses import calibrated, in_doubt
from racerl.gap.investigation import Investigation
from racerl.gap.progress import OnProgress, silent, within
from racerl.gap.score import Score, summed
from racerl.gap.screening import Screened, gainful, hopeful, lost, scores, screen, shortlist
from racerl.gap.shapes import other_shape

ROUNDS = 4
REVIEW = 0.9  # share of the naming behind which effects are judged again
SCREENED, FITTED = 0.5, 0.7  # shares of a round behind which candidates are screened, and begun to be fitted


def name_effects(
    investigation: Investigation, on_progress: OnProgress = silent, fitted: Iterable[CandidateScore] = ()
) -> Decision:
    """Return the effects that held-out windows ask for; what was `fitted` before starts from where it ended, too."""
    base = investigation.base
    on_progress("first-order gains", 0.0)
    cost = held_out(investigation, base)
    ahead = scores(investigation, base)
    score = summed(ahead.values())
    judge = Judge(investigation, cost, score)
    first = [excess(investigation, cost, investigation.floor)]
    decision = Decision(base, cost, dict(investigation.floor), investigation, {}, score, excess=first)
    known = list(fitted)
    for number in range(ROUNDS):
        if number:
            ahead = scores(investigation, decision.found)
        part = number * REVIEW / ROUNDS, (number + 1) * REVIEW / ROUNDS
        rows = _round(judge, decision, ahead, known, within(on_progress, *part))
        while rows and rows[0].needed and passes_less_noise(judge, decision, rows[0]):
            rows = judge.ranked(rows[1:], decision.cost)
        known += rows
        if (shaped := other_shape(judge, decision, rows)) is not None:
            return name_effects(shaped, within(on_progress, part[1], 1.0), known)
        decision.rounds.append(rows)
        decision.features.append(seen := features(judge, decision, rows))
        if not rows or not rows[0].needed:
            break
        if in_doubt(seen, calibrated()):
            decision.doubted = rows[0].name
            break
        found = carried(investigation, rows[0].found)
        decision = changed(investigation, decision, {**decision.kept, rows[0].name: rows}, found)
    return settled(judge, eliminated(judge, decision, within(on_progress, REVIEW, 1.0)))


def _round(
    judge: Judge,
    decision: Decision,
    ahead: Mapping[str, Score],
    known: Sequence[CandidateScore],
    on_progress: OnProgress,
) -> list[CandidateScore]:
    """Return the candidates beside those chosen, on held-out windows, best first; `known` are those of before."""
    investigation, current = judge.investigation, decision.found
    each = investigation.workers.each

    def screened(name: str) -> Screened | None:
        fitted = [row.found.vehicle.effects[name] for row in known if row.name == name]
        return screen(investigation, current, name, fitted)

    def added(one: Screened) -> FittedModel:
        return add(investigation, current, one.name, one.vehicle)

    def name_of(found: FittedModel) -> str:
        (name,) = found.effects - current.effects
        return name

    def scored(found: FittedModel) -> CandidateScore:
        return judge.score(name_of(found), converged(investigation, found), decision)

    before = {row.name for row in known} - current.effects
    asked = list(dict.fromkeys([*shortlist(ahead, lost(investigation, current)), *sorted(before)]))
    tried = each(screened, asked, within(on_progress, 0.0, SCREENED))
    shown = [one for one in tried if one is not None]
    chosen = {one.name: one for stage, score in ahead.items() for one in hopeful(shown, score, stage)}
    fitted = within(on_progress, SCREENED, FITTED)
    fits = each(added, list(chosen.values()), lambda one, share: fitted(one.name, share))
    scoring = within(on_progress, FITTED, 1.0)
    rows = each(scored, gainful(investigation, current, fits), lambda found, share: scoring(name_of(found), share))
    return judge.ranked(rows, decision.cost)
