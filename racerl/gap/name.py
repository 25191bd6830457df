"""Naming the missing effect: score the catalogue, refit the shortlist, decide on stretches that no fit has seen.

Round by round the effect that helps most on held-out windows is added, until none helps significantly; then every one
is judged again beside those found after it: what is no longer needed is taken out, and a rival that now explains more
takes its place.
"""

import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from racerl.gap.catalogue import PLACE, neutral, placed
from racerl.gap.investigation import Found, Investigation, Screened
from racerl.gap.score import Score, summed
from racerl.vehicle import catalogue
from racerl.vehicle.vehicle import Vehicle

Array = NDArray[np.float64]
OnProgress = Callable[[str, float], None]
SHORTLIST, CONTINUED = 8, 4  # candidates of each stage that are screened, and fitted to the end
FAINT = 0.15  # of the most gain in screening, below which a candidate is given up
FORETOLD, FIRST = 0.5, 2  # of the most first-order gain, above which so many are fitted whatever screening says
CARRIED = 3  # times that the fit of what was chosen is carried on, unless it is at its end before
CLOSE = 0.5  # of the most gain, above which a candidate's fit is carried on to its end
LOST = 5.0  # times the noise's cost, beyond which a fit says nothing of what is missing
HOPELESS = 30.0  # first-order gain, a χ², below which no effect is worth a fit
ROUNDS = 4
REVIEW = 0.9  # share of the naming behind which effects are judged again
SCREENED, FITTED = 0.7, 0.95  # shares of a round behind which candidates are screened, and fitted
RESAMPLES = 2000
OUTER = 0.02  # share of the blocks on each side that count no more than their neighbours
CLEAR = 3.0  # standard errors by which a gain must differ from zero
SURE = 5.0  # the same, where the excess is no larger than the noise is known
SAME = 2.0  # standard errors within which candidates explain alike
BEHIND = 3.0  # standard errors that a rival may be behind
EQUAL = 0.05  # share of the excess that a rival may explain less
PARAMETER = 0.01  # share of the excess that one more parameter must explain
WILD, TYPICAL = 30.0, 10.0  # mean squared deviation of a wild window, and its cost in median ones
FORM = 0.05  # deviation, as a share, between the parameters of an effect's forms where it has many (development logs)
EXACT = 0.01  # the same, where it has one
WORTH = 0.04  # share of the first excess, and of what is left of it before the round, that an effect must explain
REAL = 0.05  # excess cost over the noise's that is real: the noise itself is known to a few percent
ALL, SMALL = 0.75, 0.01  # shares of what is left, and of the first excess, that are not an earlier effect's wrong form
LIKE = 0.5  # |cosine| with an effect found before, from which on a small one may mend its form


@dataclass(frozen=True)
class Scored:
    """A candidate on held-out windows: its fit, its cost per window and stage, and what it gains.

    `gain` is in squared deviations, robust against wild windows, `error` its standard error over blocks of windows;
    `explained` the share that it takes of the excess in the stages that it touches, `worth` of the first one there;
    `before` is the excess before it, of the stage that has most, over the noise's cost; `behind` is by how much the
    best one of the round gains more, in standard errors of the difference.
    """

    name: str
    found: Found
    cost: dict[str, Array]
    gain: float
    error: float
    p: float
    explained: float
    worth: float
    before: float
    like: float = 0.0  # largest |cosine| with the effects beside it
    behind: float = 0.0

    @property
    def size(self) -> int:
        """Number of the effect's own parameters."""
        return sum(name.startswith(f"effects.{self.name}.") for name in self.found.problem.names)

    @property
    def clear(self) -> bool:
        """Whether the gain differs from zero."""
        return self.gain > CLEAR * self.error

    @property
    def needed(self) -> bool:
        """Whether the effect is needed.

        A small one beside a large one has to explain most of what that one leaves, and not look like it. Where the
        excess is no larger than the noise is known, shares of it say nothing, and one effect has to gain the more.
        """
        small = self.explained > ALL and self.worth > SMALL and self.before > REAL and self.like < LIKE
        sure = self.before < REAL and self.gain > SURE * self.error and self.found.effects == {self.name}
        return sure or (self.clear and self.explained >= WORTH and (self.worth >= WORTH or small))


@dataclass
class Decision:
    """What naming came to: effects in the order found, every round's candidates, best first."""

    kept: dict[str, list[Scored]]  # every effect, and its rivals, beside the others
    found: Found
    cost: dict[str, Array]  # of held-out windows
    noise: dict[str, float]  # cost that the sensors' noise alone would leave, by the first fit or this one
    score: Score  # of the refitted vehicle without effects
    rounds: list[list[Scored]] = field(default_factory=list)
    excess: list[float] = field(default_factory=list)  # of the cost over the noise, before each round and at the end

    @property
    def chosen(self) -> list[str]:
        """The effects."""
        return list(self.kept)


def name_effects(
    investigation: Investigation, seed: int, on_progress: OnProgress = lambda what, share: None
) -> Decision:
    """Return the effects that held-out windows ask for."""
    base = investigation.base
    on_progress("first-order gains", 0.0)
    cost = investigation.held_out(base)
    scores = investigation.scores(base)
    score = summed(scores.values())
    judge = Judge(investigation, seed, cost, score)
    first = [excess(investigation, cost, investigation.floor)]
    decision = Decision({}, base, cost, investigation.floor, score, excess=first)
    for number in range(ROUNDS):
        if number:
            scores = investigation.scores(decision.found)
        part = number * REVIEW / ROUNDS, (number + 1) * REVIEW / ROUNDS
        scored = _round(judge, decision, scores, within(on_progress, *part))
        while scored and scored[0].needed and _passes_less_noise(judge, decision, scored[0]):
            scored = judge.ranked(scored[1:], decision.cost)
        decision.rounds.append(scored)
        if not scored or not scored[0].needed:
            break
        decision = _with(investigation, decision, scored)
    return _settled(investigation, _reviewed(judge, decision, within(on_progress, REVIEW, 1.0)))


def _with(investigation: Investigation, decision: Decision, scored: list[Scored]) -> Decision:
    """Return the decision with the best candidate of a round."""
    found = _carried(investigation, scored[0].found)
    return _changed(investigation, decision, {**decision.kept, scored[0].name: scored}, found)


def _carried(investigation: Investigation, found: Found) -> Found:
    """Return a fit carried on: else any effect beside it gains by doing so."""
    for _ in range(CARRIED):
        found = investigation.converged(found)
    return found


def _changed(investigation: Investigation, decision: Decision, kept: dict[str, list[Scored]], found: Found) -> Decision:
    """Return the decision with other effects; a vehicle that is far off passes on too much noise: the least counts."""
    cost, passed = {**decision.cost, **investigation.held_out(found)}, investigation.noise_cost(found)
    noise = {stage: min(most, passed.get(stage, most)) for stage, most in investigation.floor.items()}
    left = [*decision.excess, excess(investigation, cost, noise)]
    return replace(decision, kept=kept, found=found, cost=cost, noise=noise, excess=left)


def _passes_less_noise(judge: "Judge", decision: Decision, best: Scored) -> bool:
    """Return whether a candidate gains by passing on less of the measured inputs' noise, not by knowing the car.

    Soft tyres that lag, and a time shift that takes the lag back, smooth what drives a slow car.
    """
    noise = judge.investigation.noise_cost(best.found)
    passed = (judge.slope(stage, decision.cost[stage]) * (decision.noise[stage] - noise[stage]) for stage in noise)
    return best.gain - sum(passed) < CLEAR * best.error


def within(on_progress: OnProgress, low: float, high: float) -> OnProgress:
    """Return the progress of a part of the work, between two shares of the whole."""
    return lambda what, share: on_progress(what, low + (high - low) * share)


def _round(judge: "Judge", decision: Decision, scores: Mapping[str, Score], on_progress: OnProgress) -> list[Scored]:
    """Return the candidates beside those chosen, on held-out windows, best first."""
    investigation, current = judge.investigation, decision.found
    lost = {stage for stage in scores if investigation.beyond(current, [stage]) > LOST}

    def screened(name: str) -> Screened | None:
        fitted = [row.found.vehicle.effects[name] for rows in decision.rounds for row in rows if row.name == name]
        return investigation.screen(current, name, fitted)

    def added(each: Screened) -> Scored:
        return judge.score(
            each.name, investigation.add(current, each.name, each.vehicle), decision.cost, decision.noise
        )

    tried = investigation.each(screened, _shortlist(scores, lost), within(on_progress, 0.0, SCREENED))
    shown = [each for each in tried if each is not None]
    hopeful = {each.name: each for name, score in scores.items() for each in _hopeful(shown, score, name)}
    fitted = within(on_progress, SCREENED, FITTED)
    scored = investigation.each(added, list(hopeful.values()), lambda each, share: fitted(each.name, share))
    most = max((row.gain for row in scored), default=0.0)

    def carried_on(row: Scored) -> Scored:
        if row.gain <= max(CLOSE * most, row.error):
            return row
        return judge.score(row.name, investigation.converged(row.found), decision.cost, decision.noise)

    ended = within(on_progress, FITTED, 1.0)
    carried = investigation.each(carried_on, scored, lambda row, share: ended(row.name, share))
    return judge.ranked(carried, decision.cost)


def _shortlist(scores: Mapping[str, Score], lost: Collection[str]) -> list[str]:
    """Return the effects with the largest first-order gains in each stage, since stages do not compete.

    Where a fit is lost, first-order theory says nothing, and all are looked at.
    """
    names: list[str] = []
    for stage, score in scores.items():
        least = 0.0 if stage in lost else HOPELESS
        gains = {name: gain for name, gain in score.gains().items() if gain > least}
        names += sorted(gains, key=lambda name: -gains[name])[: None if stage in lost else SHORTLIST]
        if stage == "chassis" and gains:  # the score knows one place only
            names += [name for name in score.names if placed(name)]
    return list(dict.fromkeys(names))


def _hopeful(tried: Sequence[Screened], score: Score, stage: str) -> list[Screened]:
    """Return the candidates that screening found to help one stage most, and those that should by first-order theory.

    A few steps do not lead every effect to where it helps.
    """
    mine = [each for each in tried if each.stage == stage and each.gain > 0.0]
    mine.sort(key=lambda each: -each.gain)
    found = [each for each in mine[:CONTINUED] if each.gain > FAINT * mine[0].gain]
    gains = score.gains()
    most = max([HOPELESS, *gains.values()])
    foretold = [each for each in tried if gains.get(each.name, 0.0) > FORETOLD * most]
    foretold.sort(key=lambda each: -gains[each.name])
    return [*found, *foretold[:FIRST]]


def _reviewed(judge: "Judge", decision: Decision, on_progress: OnProgress = lambda what, share: None) -> Decision:
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


def _judged_again(judge: "Judge", decision: Decision, name: str) -> Decision:
    """Judge an effect beside the others, and its rivals in its place: it stays, goes, or is exchanged."""
    investigation = judge.investigation
    less = _carried(investigation, investigation.without(decision.found, name))
    others = {other: rows for other, rows in decision.kept.items() if other != name}
    without = _changed(investigation, decision, others, less)
    own = judge.score(name, decision.found, without.cost, without.noise)
    if not own.needed:
        return without
    near = [row for row in decision.kept[name][1:] if close(row) and row.name not in others]
    rivals = investigation.each(lambda row: _instead(judge, without, row), near)
    sound = [rival for rival in rivals if rival.needed and not _passes_less_noise(judge, without, rival)]
    rows = judge.ranked([own, *sound], without.cost)
    kept = dict((rows[0].name, rows) if other == name else (other, kept) for other, kept in decision.kept.items())
    if rows[0].name == name:
        return replace(decision, kept=kept)
    return _changed(investigation, decision, kept, rows[0].found)


def _instead(judge: "Judge", without: Decision, rival: Scored) -> Scored:
    """Return a rival of an effect, fitted and judged beside all others."""
    investigation, effect = judge.investigation, rival.found.vehicle.effects[rival.name]
    vehicle = investigation.joined(without.found.vehicle, rival.name, effect)
    found = investigation.add(without.found, rival.name, vehicle)
    return judge.score(rival.name, _carried(investigation, found), without.cost, without.noise)


def close(row: Scored) -> bool:
    """Return whether a candidate helps, and hardly less than the best of its round."""
    return row.clear and row.behind < BEHIND


def equals(rows: Sequence[Scored]) -> list[Scored]:
    """Return the candidates that explain the data as well as the best.

    More parameters have to explain more, or to foresee held-out windows better.
    """
    best = rows[0]

    def equal(other: Scored) -> bool:
        slack = EQUAL if other.size <= best.size or other.behind < 0.0 else 0.0
        return other.explained - PARAMETER * other.size > best.explained - PARAMETER * best.size - slack

    return [other for other in rows[1:] if close(other) and equal(other)]


def _settled(investigation: Investigation, decision: Decision) -> Decision:
    """Identify everything again in all stages; take out effects whose interval then holds the value of no effect."""
    while True:
        found = investigation.everywhere(decision.found)
        ranges = intervals(found, investigation.deviations(found))
        idle = [name for name in decision.chosen if _idle(name, ranges)]
        if not idle:
            return replace(decision, found=found)
        kept = {name: rows for name, rows in decision.kept.items() if name != idle[0]}
        decision = _changed(investigation, decision, kept, investigation.without(found, idle[0]))


def _idle(name: str, ranges: Mapping[str, tuple[float, float, float]]) -> bool:
    first, zero = neutral(name)
    if not catalogue.entry(name).cls.vanishes:
        return False
    _, low, high = ranges[f"effects.{name}.{first}"]
    return low <= zero <= high


def intervals(found: Found, deviations: Mapping[str, float]) -> dict[str, tuple[float, float, float]]:
    """Return each fitted parameter's value and 95 % interval, inside the physical bounds, from its deviation.

    An effect's parameters are known no better than its form is: the car's effect may have another.
    """
    bounds = {unknown.name: (unknown.low, unknown.high) for unknown in found.problem.unknowns}
    ranges = {}
    for name, deviation in deviations.items():
        value, (low, high) = found.theta[name], bounds[name]
        half = 1.96 * math.hypot(deviation, _form(found.vehicle, name, value))
        ranges[name] = value, max(value - half, low), min(value + half, high)
    return ranges


def _form(vehicle: Vehicle, parameter: str, value: float) -> float:
    """Return the deviation between a parameter of an effect's likely forms, by its distance from no effect.

    That of a place is in the effect's own length.
    """
    name, _, key = parameter.removeprefix("effects.").rpartition(".")
    effect = vehicle.effects.get(name)
    if effect is None or not effect.physical:
        return 0.0
    first, zero = neutral(name)
    size = value - zero if key == first else value
    if placed(name) and key in PLACE:
        size = float(getattr(effect, "radius", 0.0))
    return (EXACT if effect.exact else FORM) * abs(size)


def excess(investigation: Investigation, cost: Mapping[str, Array], noise: Mapping[str, float]) -> float:
    """Return the cost beyond what the sensors' noise alone would leave; wild windows count up to a limit."""
    return total(excesses(investigation, cost, noise).values())


def total(parts: Iterable[float]) -> float:
    """Return the sum of some stages' excesses; one below zero makes up for no other."""
    return sum(max(0.0, part) for part in parts)


def excesses(investigation: Investigation, cost: Mapping[str, Array], noise: Mapping[str, float]) -> dict[str, float]:
    """Return the excess of every stage; below zero where the noise is known too badly."""
    return {name: float(np.minimum(part, wild(investigation, name)).sum()) - noise[name] for name, part in cost.items()}


def wild(investigation: Investigation, stage: str, cost: Array | None = None) -> float:
    """Return the cost of a window beyond which its size says nothing more, from costs (the nominal fit's)."""
    usual = investigation.base.cost[stage] if cost is None else cost
    return max(WILD * investigation.evidence[stage].numbers, TYPICAL * float(np.median(usual)))


def _winsorised(sums: Array) -> Array:
    """Return values with the outermost on each side moved to their neighbours."""
    ordered = np.sort(sums)
    outer = max(1, round(OUTER * len(sums)))
    return np.clip(sums, ordered[outer], ordered[-1 - outer]) if len(sums) > 2 * outer + 1 else sums


@dataclass(frozen=True)
class Judge:
    """Judges fits by held-out costs, with block bootstrap."""

    investigation: Investigation
    seed: int  # of the resamples
    first: Mapping[str, Array]  # costs without any effect
    nominal: Score = Score([], np.zeros((0, 0)), np.zeros(0))  # there, of the catalogue's effects

    def score(self, name: str, found: Found, before: Mapping[str, Array], noise: Mapping[str, float]) -> Scored:
        """Return what a fit with an effect more gains upon the costs before it, of which noise has its share."""
        cost = self.investigation.held_out(found)
        gain, error = self.gain(before, cost)
        stages = self.investigation.touched(found.vehicle, frozenset([name]))
        parts = [
            excesses(self.investigation, {stage: part[stage] for stage in stages}, noise)
            for part in (before, cost, self.first)
        ]
        had, left, first = (total(part.values()) for part in parts)
        least = 0.001 * sum(noise[stage] for stage in stages)  # so small an excess is noise itself
        share, worth = (had - left) / max(had, least), (had - left) / max(first, least)
        most = max(part / noise[stage] for stage, part in parts[0].items())
        like = self.nominal.likeness(name, found.effects - {name})
        return Scored(name, found, cost, gain, error, self.chance(before, cost), share, worth, most, like)

    def ranked(self, scored: Sequence[Scored], before: Mapping[str, Array]) -> list[Scored]:
        """Return candidates, best first: by their gains, but of those alike the one that explains most first."""
        rows = sorted(scored, key=lambda row: -row.gain)
        if rows:
            alike = [row for row in rows if row.clear >= rows[0].clear and self.behind(rows[0], row, before) < SAME]
            first = max(alike, key=lambda row: row.explained - PARAMETER * row.size)
            rows = [first, *(row for row in rows if row is not first)]
        return [replace(row, behind=self.behind(rows[0], row, before)) for row in rows]

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
        generator = np.random.default_rng(self.seed)
        drawn = sums[generator.integers(len(sums), size=(RESAMPLES, len(sums)))].sum(axis=1)
        return float((drawn <= 0.0).mean())

    def _blocks(self, before: Mapping[str, Array], after: Mapping[str, Array]) -> Array:
        """Return the fall of the loss by block, (B,), winsorised: no block decides alone."""
        parts = []
        for stage in after:
            if stage in before:
                fall = self.loss(stage, before[stage]) - self.loss(stage, after[stage])
                parts.append(_winsorised(np.bincount(self.investigation.blocks(stage), fall).astype(float)))
        return np.concatenate(parts)

    def loss(self, stage: str, cost: Array) -> Array:
        """Return n log(1 + cost/n), n the cost of a usual window: one that no fit foresaw does not decide alone.

        A fit must not give windows up, and counts them by the root of their cost; a judgement of it may.
        """
        n = wild(self.investigation, stage) / WILD
        return n * np.log1p(cost / n)

    def slope(self, stage: str, cost: Array) -> float:
        """Return the mean slope of the loss at some windows' costs."""
        n = wild(self.investigation, stage) / WILD
        return float((1.0 / (1.0 + cost / n)).mean())
