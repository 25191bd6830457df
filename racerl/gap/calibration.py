"""Fitting the rule of `hypotheses` to diagnoses of simulated cars whose effects are known."""

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.stats import binom

from racerl.gap.hypotheses import (
    CANDIDATE,
    LEFT,
    LEVEL,
    STOP,
    UNLISTED,
    Hypothesis,
    Round,
    Rule,
    candidate_features,
    credible,
    hypotheses,
    left_features,
    stop_features,
)

Array = NDArray[np.float64]
WIDE = 3.0  # deviation of the weights' priors
BINS = 5  # of probabilities
TRUST = 0.9  # probability that sets hold the truth as often as they should
DRAWS = 2000  # of what was hidden, by the probabilities told


class Case(NamedTuple):
    """A diagnosis: what was hidden, that of the catalogue by name, and what every round of naming saw."""

    hidden: frozenset[str]
    unlisted: bool
    rounds: Sequence[Round]


class Check(NamedTuple):
    """How probabilities fare on cases that their rule was not fitted to.

    `covered`: share of cases whose truth is in the set of hypotheses; `size`: how many it has in the mean; `first`:
    share whose truth is the most probable; `error`: mean difference between the first's probability and how often it is
    right, over bins of probability, weighted by their cases; `chance`: the mean of that over draws in which the same
    probabilities are right; `one_…`: of the cases with one effect alone.
    """

    cases: int
    covered: float
    size: float
    first: float
    error: float
    chance: float
    one_cases: int
    one_covered: float | None
    one_size: float | None


class Choice(NamedTuple):
    """A round: features of none and of each candidate, and which of these, none first, is right (1 + N,)."""

    stop: Array
    candidates: Array
    right: NDArray[np.bool_]


def calibrate(cases: Sequence[Case]) -> Rule:
    """Return the rule under which what was hidden is most likely, with weak priors around zero.

    Rounds count as far as what was added before them was hidden.
    """
    rounds = [choice for case in cases for choice in choices(case)]
    split = len(CANDIDATE)

    def chosen(w: Array) -> float:
        loss = 0.0
        for each in rounds:
            odds = np.concatenate([[w[split:] @ each.stop], each.candidates @ w[:split]])
            loss -= np.logaddexp.reduce(odds[each.right]) - np.logaddexp.reduce(odds)
        return loss

    ended = [(left_features(case.rounds), case.unlisted) for case in cases]

    def left(w: Array) -> float:
        odds = np.array([z @ w for z, _ in ended])
        signs = np.array([1.0 if missed else -1.0 for _, missed in ended])
        return float(np.logaddexp(0.0, -signs * odds).sum())

    w, u = (_least(loss, size) for loss, size in ((chosen, split + len(STOP)), (left, len(LEFT))))
    return Rule(w[:split], w[split:], u)


def checked(cases: Sequence[Case], groups: Sequence[str]) -> tuple[float, Check]:
    """Fit to all groups of cases but one, and check the rule on that one, for each group.

    Return how probable hypotheses of a set have to be for that, and the check of sets of those that are.
    """
    told: list[list[Hypothesis]] = []
    truths: list[tuple[str, ...]] = []
    for group in sorted(set(groups)):
        rule = calibrate([case for case, own in zip(cases, groups, strict=True) if own != group])
        for case in (case for case, own in zip(cases, groups, strict=True) if own == group):
            told.append(hypotheses(case.rounds, rule))
            truths.append(truth_of(case))
    least = conformal(told, truths)
    return least, compared(told, truths, least)


def conformal(told: Sequence[Sequence[Hypothesis]], truths: Sequence[tuple[str, ...]]) -> float:
    """Return from which probability on sets hold the truth in LEVEL or more of further cars that lack one effect.

    TRUST is how sure that is, by these n cars alone: k of them may be missed where so few, or fewer, would be with a
    chance of 1 − TRUST at most if 1 − LEVEL of all cars were. 0 where they are too few. Source: Vovk, "Conditional
    validity of inductive conformal predictors", 2012.
    """
    found = sorted(_told_with(each, truth) for each, truth in zip(told, truths, strict=True) if _is_one(truth))
    missed = np.flatnonzero(binom.cdf(np.arange(len(found)), len(found), 1.0 - LEVEL) <= 1.0 - TRUST)
    return found[missed[-1]] if len(missed) else 0.0


def _told_with(told: Sequence[Hypothesis], truth: tuple[str, ...]) -> float:
    return next((each.probability for each in told if each.names == truth), 0.0)


def _is_one(truth: tuple[str, ...]) -> bool:
    return len(truth) == 1 and truth[0] != UNLISTED


def compared(told: Sequence[Sequence[Hypothesis]], truths: Sequence[tuple[str, ...]], least: float) -> Check:
    """Compare hypotheses, most probable first, and their sets with what was hidden."""
    sets = [credible(each, least) for each in told]
    covered = np.array([truth in [each.names for each in among] for among, truth in zip(sets, truths, strict=True)])
    first = np.array([each[0].names == truth for each, truth in zip(told, truths, strict=True)], float)
    p = np.array([each[0].probability for each in told])
    drawn = np.random.default_rng(0).random((DRAWS, len(p))) < p
    size, one = np.array([len(among) for among in sets]), np.array([_is_one(truth) for truth in truths])
    ones = (float(each[one].mean()) if one.any() else None for each in (covered, size))
    chance = float(np.mean([_away(p, each) for each in drawn]))
    means = float(covered.mean()), float(size.mean()), float(first.mean())
    return Check(len(p), *means, _away(p, first), chance, int(one.sum()), *ones)


def _away(p: Array, right: Array) -> float:
    """Return by how much probabilities differ from how often they are right, over bins, weighted by their cases."""
    bins = np.minimum((p * BINS).astype(int), BINS - 1)
    return float(np.abs(np.bincount(bins, right - p, BINS)).sum() / len(p))


def truth_of(case: Case) -> tuple[str, ...]:
    """Return what was hidden as a hypothesis has it."""
    return tuple(sorted([*case.hidden, *([UNLISTED] if case.unlisted else [])]))


def choices(case: Case) -> Iterator[Choice]:
    """Yield the rounds of a case up to the first that added what was not hidden."""
    added: set[str] = set()
    for each in case.rounds:
        names = [row["name"] for row in each["candidates"]]
        right = np.array([False, *(name in case.hidden - added for name in names)])
        right[0] = not right.any()  # none of these
        yield Choice(stop_features(each), candidate_features(each), right)
        if not names or names[0] not in case.hidden:
            return
        added.add(names[0])


def _least(loss: Callable[[Array], float], size: int) -> Array:
    found = minimize(lambda w: loss(w) + 0.5 * float(w @ w) / WIDE**2, np.zeros(size), method="BFGS")
    weights: Array = found.x
    return weights
