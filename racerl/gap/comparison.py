"""Comparing fitted models on windows that they have not seen: what a candidate gains, and how sure that is."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from racerl.estimation.blocks import CLEAR, nested_counts, standard_error, winsorised
from racerl.gap.cross_validation import held_out
from racerl.gap.fitted_model import FittedModel, touched
from racerl.gap.folds import blocks
from racerl.gap.investigation import Investigation
from racerl.gap.score import FELT, REMAINDER, Score
from racerl.gap.stage import TYRES

Array = NDArray[np.float64]
Loss = Callable[[str, Array], Array]
RESAMPLES = 2000
OUTER = 0.02  # share of the blocks on each side that count no more than their neighbours
FEW = 8  # blocks, below which each counts as it is
STAYS = 2.0  # standard errors with which an effect found before others stays: fewer than CLEAR, or chance decides
SURE = 5.0  # those that it takes where the excess is no larger than the noise is known
SAME = 2.0  # standard errors within which candidates explain alike
BEHIND = 3.0  # standard errors that a rival may be behind
EQUAL = 0.05  # share of the excess that a rival may explain less
PARAMETER = 0.01  # share of the excess that one more parameter must explain
WILD, TYPICAL = 30.0, 10.0  # mean squared deviation of a wild window, and its cost in median ones
WORTH = 0.04  # share of the first excess, and of what is left of it before the round, that an effect must explain
# excess over the noise's cost that clean cars of other formulas leave of the refit: up to 1 % of seven on Burckhardt,
# TMsimple and other slips, 5 and 9 % of two on Dugoff tyres
FOREIGN = 0.1
REAL = 0.05  # excess cost over the noise's that is real: the noise itself is known to a few percent
WORSE = 1.05  # times the error before, beyond which it has grown
ALL, SMALL = 0.75, 0.01  # shares of what is left, and of the first excess, that are not an earlier effect's wrong form
MOST = 0.5  # the share of what is left where that is more than a wrong form, or another formula, leaves
LIKE = 0.5  # |cosine| with an effect found before, from which on a small one may mend its form


@dataclass
class Standing:
    """A fit that candidates are judged beside: its cost on held-out windows, and what noise alone would leave."""

    found: FittedModel
    cost: dict[str, Array]
    noise: dict[str, float]


@dataclass(frozen=True)
class CandidateScore:
    """A candidate on held-out windows: its fit, its cost per window and stage, and what it gains.

    `gain` is in squared deviations, robust against wild windows, `error` its standard error over blocks of windows;
    `p` the share of resamples of these without a gain; `explained` the share that it takes of the excess in the stages
    that it touches, `worth` of the first one there; `before` is the excess that the fit before it leaves, of the stage
    that has most, over the noise's cost; `behind` is by how much the best one of the round gains more, in standard
    errors of the difference.
    """

    name: str
    found: FittedModel
    cost: dict[str, Array]
    gain: float
    error: float
    p: float
    explained: float
    worth: float
    before: float
    fall: float = np.inf  # of the excess, over the noise's cost
    foreign: bool = False  # it acts on tyres that had to be of another shape than their formula's
    like: float = 0.0  # largest |cosine| with the effects beside it
    behind: float = 0.0
    leads: float = 1.0  # share of resamples in which it comes first of its round
    more: int = 0  # parameters that came with the effect and are not its own

    @property
    def size(self) -> int:
        """Number of the parameters that came with the effect."""
        return self.more + sum(name.startswith(f"effects.{self.name}.") for name in self.found.problem.names)

    @property
    def clear(self) -> bool:
        """Whether the gain differs from zero."""
        return self.gain > CLEAR * self.error

    @property
    def needed(self) -> bool:
        """Whether the effect is needed."""
        return self._asked_for(CLEAR)

    @property
    def stays(self) -> bool:
        """Whether an effect that was needed before others were found still is."""
        return self._asked_for(STAYS)

    def _asked_for(self, errors: float) -> bool:
        """Return whether held-out windows ask for the effect, by a gain of so many standard errors.

        A small one beside a large one has to explain three quarters of what that one leaves, or half of it where much
        is left, and not look like it. Where the excess is no larger than the noise is known, shares of it say nothing,
        and one effect has to gain the more. Where the fit is at the noise, what held-out windows cost beyond it is what
        their folds know too badly. Of a tyre of another formula something stays of which an effect of the motion may
        take a part for its own, but hardly all; and every car is a trifle away from its model.
        """
        share = MOST if self.before > FOREIGN and not self.foreign else ALL
        small = self.explained > share and self.worth > SMALL and self.before > REAL and self.like < LIKE
        sure = self.before < REAL and self.gain > SURE * self.error and self.found.effects == {self.name}
        left = self.before > 0.0 and self.explained >= WORTH and (self.worth >= WORTH or small)
        if self.foreign:
            real = self.before > FOREIGN or self.explained > ALL
            sure, left = False, left and real and self.fall > REMAINDER
        return self.fall > FELT and (sure or (self.gain > errors * self.error and left))


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


def _outer(count: int) -> int:
    """Return how many of so many blocks count no more than their neighbours, on each side; of few none."""
    return max(1, round(OUTER * count)) if count >= FEW else 0


def close(row: CandidateScore, best: CandidateScore) -> bool:
    """Return whether a candidate helps as clearly as the best of its round, and hardly less."""
    return row.clear >= best.clear and row.behind < BEHIND


def equals(rows: Sequence[CandidateScore]) -> list[CandidateScore]:
    """Return the candidates that explain the data as well as the best.

    More parameters have to explain more, or to foresee held-out windows better.
    """
    best = rows[0]

    def equal(other: CandidateScore) -> bool:
        slack = EQUAL if other.size <= best.size or other.behind < 0.0 else 0.0
        return other.explained - PARAMETER * other.size > best.explained - PARAMETER * best.size - slack

    return [other for other in rows[1:] if close(other, best) and equal(other)]


@dataclass(frozen=True)
class Judge:
    """Judges fits by held-out costs, with block bootstrap."""

    investigation: Investigation
    first: Mapping[str, Array]  # costs without any effect
    nominal: Score = Score([], np.zeros((0, 0)), np.zeros(0))  # there, of the catalogue's effects

    def score(self, name: str, found: FittedModel, standing: Standing) -> CandidateScore:
        """Return what a fit with an effect more gains upon the one before it."""
        investigation, before, noise = self.investigation, standing.cost, standing.noise
        cost = held_out(investigation, found)
        gain, error = self.gain(before, cost)
        stages = touched(investigation, found.vehicle, [name])
        had, left, first = (
            total(excesses(investigation, {stage: part[stage] for stage in stages}, noise).values())
            for part in (before, cost, self.first)
        )
        least = 0.001 * sum(noise[stage] for stage in stages)  # so small an excess is noise itself
        fit = {stage: investigation.cost(standing.found, stage) for stage in stages}
        most = max(part / noise[stage] for stage, part in excesses(investigation, fit, noise).items())
        return CandidateScore(
            name=name,
            found=found,
            cost=cost,
            gain=gain,
            error=error,
            p=self.chance(before, cost),
            explained=(had - left) / max(had, least),
            worth=(had - left) / max(first, least),
            before=most,
            fall=(had - left) / sum(noise[stage] for stage in stages),
            foreign=investigation.shaped and TYRES in stages,
            like=self.nominal.likeness(name, found.effects - {name}),
        )

    def ranked(self, scored: Sequence[CandidateScore], before: Mapping[str, Array]) -> list[CandidateScore]:
        """Return candidates, best first: by their gains, but of those alike the one that explains most first.

        Of effects that are one in this log the first by name stands for all, whatever the last digits of their fits.
        """
        rows = sorted(scored, key=lambda row: -row.gain)
        if rows:
            alike = [row for row in rows if row.clear >= rows[0].clear and self.behind(rows[0], row, before) < SAME]
            first = max(alike, key=lambda row: row.explained - PARAMETER * row.size)
            one = [row for row in rows if row is first or (self.one(first, row) and row.needed >= first.needed)]
            first = min(one, key=lambda row: row.name)
            rows = [first, *(row for row in rows if row is not first)]
        rows = [replace(row, behind=self.behind(rows[0], row, before)) for row in rows]
        return [replace(row, leads=share) for row, share in zip(rows, self._leads(rows, before), strict=True)]

    def _leads(self, rows: Sequence[CandidateScore], before: Mapping[str, Array]) -> list[float]:
        """Return the share of resamples of the runs in which each candidate gains and comes first, as in `ranked`."""
        if not rows:
            return []
        index = self._resamples(before)
        gains, falls = (
            index @ np.stack([self._blocks(before, {**before, **row.cost}, loss) for row in rows], axis=1)
            for loss in (self.loss, self._clipped)
        )
        best, errors = gains.max(axis=1), np.array([self._error(rows[0], row, before) for row in rows])
        apart = np.tile(errors, (RESAMPLES, 1))
        apart[:, 0] = errors[gains.argmax(axis=1)]
        usual = falls.mean(axis=0)  # of one that helps no resample says by how much more
        ratio = np.divide(falls, usual, out=np.ones_like(falls), where=usual > 0.0)
        shares = np.array([row.explained for row in rows]) * ratio
        alike = (best[:, None] - gains <= SAME * apart) & (gains > 0.0)
        worth = np.where(alike, shares - PARAMETER * np.array([row.size for row in rows]), -np.inf)
        first = np.where(best > 0.0, worth.argmax(axis=1), -1)
        came = [float((first == i).mean()) for i in range(len(rows))]
        return [
            sum(came[j] for j, other in enumerate(rows) if j == i or self.one(row, other)) for i, row in enumerate(rows)
        ]

    def _clipped(self, stage: str, cost: Array) -> Array:
        return np.minimum(cost, wild(self.investigation, stage))

    def _error(self, best: CandidateScore, other: CandidateScore, before: Mapping[str, Array]) -> float:
        return self.gain({**before, **other.cost}, {**before, **best.cost})[1]

    def one(self, row: CandidateScore, other: CandidateScore) -> bool:
        """Return whether two candidates are one in this log, and their fits ended alike."""
        return self.nominal.one(row.name, other.name) and abs(row.explained - other.explained) < EQUAL

    def behind(self, best: CandidateScore, other: CandidateScore, before: Mapping[str, Array]) -> float:
        """Return by how many standard errors a candidate is worse than the best."""
        if other is best or self.one(best, other):
            return 0.0
        gain, error = self.gain({**before, **other.cost}, {**before, **best.cost})
        return gain / max(error, 1e-9)

    def gain(self, before: Mapping[str, Array], after: Mapping[str, Array]) -> tuple[float, float]:
        """Return the fall of the loss over the stages in both, and its standard error over blocks of windows."""
        sums = self._sums(before, after)
        outer = _outer(len(sums))
        return float(winsorised(sums, outer).sum()), standard_error(sums, outer)

    def chance(self, before: Mapping[str, Array], after: Mapping[str, Array]) -> float:
        """Return the share of resamples of the runs in which the loss does not fall."""
        stages = {stage: part for stage, part in after.items() if stage in before}
        return float((self._resamples(stages) @ self._blocks(before, stages) <= 0.0).mean())

    def _resamples(self, stages: Iterable[str]) -> Array:
        """Return how often each block of some stages is drawn, (RESAMPLES, B): of runs, and of stretches in these."""
        stages = list(stages)
        number, run = self._number(stages), np.concatenate([self.investigation.evidence[each].run for each in stages])
        first = np.unique(number, return_index=True)[1]
        return nested_counts(run[first], RESAMPLES, np.random.default_rng(self.investigation.seed))

    def _number(self, stages: Iterable[str]) -> NDArray[np.int64]:
        """Return the block of every window of some stages, one stage after the other."""
        return np.concatenate(list(blocks({stage: self.investigation.evidence[stage] for stage in stages}).values()))

    def _blocks(self, before: Mapping[str, Array], after: Mapping[str, Array], loss: Loss | None = None) -> Array:
        """Return the fall of a loss by block, (B,), winsorised: no block decides alone."""
        sums = self._sums(before, after, loss)
        return winsorised(sums, _outer(len(sums)))

    def _sums(self, before: Mapping[str, Array], after: Mapping[str, Array], loss: Loss | None = None) -> Array:
        loss, stages = loss or self.loss, [stage for stage in after if stage in before]
        falls = [loss(stage, before[stage]) - loss(stage, after[stage]) for stage in stages]
        sums = np.bincount(self._number(stages), np.concatenate(falls))
        return sums.astype(float)

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
