"""What may be hidden, with probabilities: a small rule that simulated cars have calibrated, applied round by round.

In a round a car lacks one of the candidates, or none of them. Their odds are those of a conditional logit,

    p(candidate) ∝ exp(w · x),   p(none of them) ∝ exp(v · y),

x what the candidate gains on held-out windows, y what there is to be gained. Whether what is left behind the last round
is something of no catalogue has the odds exp(u · z), z what is left. Weights and their source: calibration.json.
"""

from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from racerl.documents import read_json

Array = NDArray[np.float64]
Round = Mapping[str, Any]  # what `features` returns
UNLISTED = "?"  # something that is not in the catalogue
CANDIDATE = ("constant", "needed", "errors", "explained", "fall", "behind", "leads", "like")
STOP = ("excess",)
LEFT = ("constant", "left", "share")
SMALL = 0.02  # of the noise's cost: an excess below it counts as none
CALIBRATION = Path(__file__).with_name("calibration.json")
LARGE = 1.0  # of the noise's cost: an excess beyond it is no tyre's, whatever its formula
LEAST = 1.0  # squared deviation, as which an error counts at least
LEVEL = 0.95  # share of cars that lack one effect, whose set of hypotheses holds it at least
RAREST = 0.005  # probability below which a hypothesis is not told


class Hypothesis(NamedTuple):
    """What may be hidden: effects by name, among them UNLISTED for what the catalogue lacks; none if empty."""

    names: tuple[str, ...]
    probability: float


class Rule(NamedTuple):
    """Weights of the features that the names above list."""

    candidate: Array
    stop: Array
    left: Array

    @classmethod
    def of(cls, weights: Mapping[str, Mapping[str, float]]) -> "Rule":
        """Return a rule from its weights by feature."""
        parts = {"candidate": CANDIDATE, "stop": STOP, "left": LEFT}
        return cls(*(np.array([weights[part][name] for name in names]) for part, names in parts.items()))

    def weights(self) -> dict[str, dict[str, float]]:
        """Return the weights by feature."""
        parts = zip(self._fields, self, (CANDIDATE, STOP, LEFT), strict=True)
        return {part: dict(zip(names, own.tolist(), strict=True)) for part, own, names in parts}


@cache
def calibrated() -> Rule:
    """Return the rule that comes with the package."""
    return Rule.of(read_json(CALIBRATION)["weights"])


def hypotheses(rounds: Sequence[Round], rule: Rule) -> list[Hypothesis]:
    """Return what may be hidden, most probable first; the first candidate of every round but the last was added.

    A candidate that was not added counts as followed by what followed the one that was.
    """
    found: list[Hypothesis] = []
    added: tuple[str, ...] = ()
    reached, missed = 1.0, unlisted(rounds, rule)
    chosen = [choice(each, rule).tolist() for each in rounds]
    for each, (none, *chances), later in zip(rounds, chosen, [*chosen[1:], None], strict=True):
        found.append(Hypothesis(added, reached * none))
        then = 1.0 if later is None else later[0]
        others = each["candidates"] if later is None else each["candidates"][1:]
        for row, chance in zip(others, chances[len(chances) - len(others) :], strict=True):
            found.append(Hypothesis((*added, row["name"]), reached * chance * then))
        if later is not None:
            added, reached = (*added, each["candidates"][0]["name"]), reached * chances[0]
    return _told(found, missed)


@cache
def calibrated_least() -> float:
    """Return the probability from which on the package's sets of hypotheses hold the truth as often as they should."""
    return float(read_json(CALIBRATION)["least"])


def credible(told: Sequence[Hypothesis], least: float) -> list[Hypothesis]:
    """Return the set of hypotheses, most probable first: those with a probability of `least` or more, and the first.

    Where simulated cars with one effect say how small that has to be, the set holds the truth in LEVEL of such cars or
    more (conformal prediction; of all sets that do, these are the smallest in the mean: Sadinle, Lei, Wasserman 2019).
    """
    return [each for number, each in enumerate(told) if number == 0 or each.probability >= least]


def choice(each: Round, rule: Rule) -> Array:
    """Return the probabilities in a round: of none of the candidates, and of each, (1 + N,)."""
    odds = np.array([rule.stop @ stop_features(each), *(rule.candidate @ x for x in candidate_features(each))])
    raised: Array = np.exp(odds - odds.max())
    return raised / raised.sum()


def in_doubt(each: Round, rule: Rule) -> bool:
    """Return whether none of a round's candidates is more probable than all of them together.

    Not where the excess is large: a real car lacks what has a name and what has none, no simulated one lacked both.
    """
    return max(each["fit"].values()) < LARGE and float(choice(each, rule)[0]) > 0.5


def candidate_features(each: Round) -> Array:
    """Return what the candidates of a round gain, (N, len(CANDIDATE))."""
    rows = [
        (
            1.0,
            float(row["needed"]),
            np.log1p(max(row["gain"], 0.0) / max(row["error"], LEAST)),
            float(np.clip(row["explained"], 0.0, 1.0)),
            np.log(max(row["fall"], SMALL) / SMALL),
            min(row["behind"], 8.0),
            np.log(row["leads"] + 0.02),
            row["like"],
        )
        for row in each["candidates"]
    ]
    return np.array(rows).reshape(-1, len(CANDIDATE))


def stop_features(each: Round) -> Array:
    """Return what there is to be gained in a round, (len(STOP),)."""
    return np.array([_logarithm(sum(max(part, 0.0) for part in each["held_out"].values()))])


def left_features(rounds: Sequence[Round]) -> Array:
    """Return what the last round begins with, of the stage that has most left, (len(LEFT),)."""
    first, last = rounds[0]["fit"], rounds[-1]["fit"]
    stage = max(last, key=lambda name: last[name])
    share = max(last[stage], 0.0) / max(first[stage], SMALL)
    return np.array([1.0, _logarithm(last[stage]), float(np.clip(share, 0.0, 1.0))])


def _logarithm(excess: float) -> float:
    return float(np.log1p(max(excess, 0.0) / SMALL))


def unlisted(rounds: Sequence[Round], rule: Rule) -> float:
    """Return the probability that what is left behind the last round is something of no catalogue."""
    return float(1.0 / (1.0 + np.exp(-(rule.left @ left_features(rounds)))))


def _told(found: Sequence[Hypothesis], missed: float) -> list[Hypothesis]:
    """Return each hypothesis without and with something unlisted, most probable first, as shares of all."""
    sums: dict[tuple[str, ...], float] = {}
    for names, p in found:
        for key, share in ((names, 1.0 - missed), ((*names, UNLISTED), missed)):
            sums[tuple(sorted(key))] = sums.get(tuple(sorted(key)), 0.0) + p * share
    total = sum(sums.values())
    told = sorted((Hypothesis(names, p / total) for names, p in sums.items()), key=lambda each: -each.probability)
    return [each for each in told if each.probability > RAREST]
