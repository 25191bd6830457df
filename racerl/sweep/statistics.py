"""From laps to verdicts: means over seeds, contrasts between arms, intervals by stratified bootstrap.

Trainings (seeds) are drawn with replacement, the same ones for all arms; inside each its starts, the same for all
arms; inside each start its laps. What is not trained has starts and laps alone. A metric is taken per training and
averaged over them. A claim is supported where the 95 % interval of every test's contrast lies on the claimed side,
refuted where one lies on the other side, not tested where no test has what it needs, and undecided otherwise. Nothing
is decided by arms that were trained once, by intervals without width, or by trainings of a trial budget. A training
without a lap to take a time from counts as slower than the others of its arm; an arm without any is not tested.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from racerl.sweep.definition import METRICS, OF_TRAINING, Claim, Comparison, Sweep
from racerl.sweep.jobs import UNTRAINED

Array = NDArray[np.float64]
RESAMPLES = 1000
LEVEL = 0.95
TRIAL = "trial budget"
BEYOND = 1e12  # of any metric: ∞
MANY = 100  # trainings of an arm, more than which nobody makes for one claim
VERDICTS = ("supported", "refuted", "undecided", "not tested")
MEASURES = ("time_s", "e_off", "off_track_m", "crashed", "valid", "turn_in_m")


@dataclass(frozen=True)
class Samples:
    """Every metric of every arm of a sweep in one car: of each training, and resampled, (R,)."""

    seeds: Sequence[int]
    trained: Mapping[str, Sequence[int]]  # arm → the seeds that it has, UNTRAINED alone for what is not trained
    per_seed: Mapping[str, Mapping[str, Array]]  # arm → metric → one for each of those
    resampled: Mapping[str, Mapping[str, Array]]  # arm → metric → (R,)
    laps: Mapping[str, int]  # arm → laps driven

    def value(self, arm: str, metric: str) -> float:
        """Return an arm's metric, averaged over trainings; NaN where one has none, ∞ where one has no lap to time."""
        return float(np.mean(self.per_seed[arm][metric]))

    def shared(self, arms: Iterable[str], metric: str) -> dict[str, Array]:
        """Return the metric of arms seed by seed, over the seeds that all trained ones have."""
        own = {arm: list(self.trained[arm]) for arm in arms}
        common = [seed for seed in self.seeds if all(seed in has or has == [UNTRAINED] for has in own.values())]
        rows = {arm: [0] if has == [UNTRAINED] else [has.index(seed) for seed in common] for arm, has in own.items()}
        return {arm: self.per_seed[arm][metric][index] for arm, index in rows.items()}

    def trainings(self, arms: Iterable[str]) -> int | None:
        """Return how often the least trained of some arms was trained; None where none of them trains."""
        counts = [len(self.trained[arm]) for arm in arms if list(self.trained[arm]) != [UNTRAINED]]
        return min(counts, default=None)

    def interval(self, arm: str, metric: str) -> list[float] | None:
        """Return its 95 % interval; None where too few resamples have a value, or where it has no end."""
        return ended(spread(self.resampled[arm][metric]))


def resample(laps: pd.DataFrame, rewards: pd.DataFrame, generator: np.random.Generator) -> Samples:
    """Return the samples of one sweep in one car, from rows of laps and of trainings.

    Starts are drawn by their places among an arm's own, the same places for all arms.
    """
    seeds = sorted({int(seed) for seed in laps["seed"]} - {UNTRAINED}) or [UNTRAINED]
    arms = list(dict.fromkeys(laps["arm"]))
    blocks = {
        key: rows[list(MEASURES)].to_numpy(dtype=float)
        for key, rows in laps.groupby(["arm", "seed", "start"], sort=True)
    }
    starts: dict[tuple[str, int], list[int]] = {}
    for arm, seed, start in blocks:
        starts.setdefault((arm, seed), []).append(start)
    most = max(map(len, starts.values()), default=0)
    learned = {
        (arm, seed): dict(zip(OF_TRAINING, row, strict=True))
        for arm, seed, *row in rewards.reindex(columns=["arm", "seed", *OF_TRAINING]).itertuples(index=False)
    }

    def metrics(arm: str, seed: int, places: Array | None = None) -> dict[str, float]:
        own = starts.get((arm, seed), [])
        if places is None:
            parts = [blocks[arm, seed, start] for start in own]
        else:
            parts = [blocks[arm, seed, own[int(place * len(own))]] for place in places[: len(own)]]
            parts = [part[generator.integers(len(part), size=len(part))] for part in parts]
        laps = np.concatenate(parts) if parts else np.zeros((0, len(MEASURES)))
        return {**_metrics(laps), **{name: float(learned[arm, seed][name]) for name in OF_TRAINING}}

    of = {arm: [seed for seed in sorted({UNTRAINED, *seeds}) if (arm, seed) in learned] for arm in arms}
    per_seed = {arm: _table([metrics(arm, seed) for seed in of[arm]]) for arm in arms}
    rows: dict[str, list[dict[str, float]]] = {arm: [] for arm in arms}
    for _ in range(RESAMPLES):
        chosen = generator.choice(seeds, size=len(seeds))
        drawn = [generator.random(most) for _ in chosen]
        for arm in arms:
            asked = [(UNTRAINED, drawn[0])] if UNTRAINED in of[arm] else list(zip(chosen, drawn, strict=True))
            found = [metrics(arm, int(seed), places) for seed, places in asked if int(seed) in of[arm]]
            rows[arm].append(
                {name: float(np.mean([each[name] for each in found])) if found else math.nan for name in METRICS}
            )
    driven = {arm: int((laps["arm"] == arm).sum()) for arm in arms}
    return Samples(seeds, of, per_seed, {arm: _table(row) for arm, row in rows.items()}, driven)


def _metrics(laps: Array) -> dict[str, float]:
    """Return the metrics of laps (L, 6) in the order of MEASURES; without any to take it from NaN, a time ∞."""
    time, e_off, off, crashed, valid, lead = laps.T
    if not len(laps):  # a car that creeps is given up before its first
        return {name: math.nan for name in METRICS if name not in OF_TRAINING}
    timed, clean, led = time[~np.isnan(time)], time[valid > 0.5], lead[~np.isnan(lead)]
    return {
        "lap_time": float(timed.mean()) if len(timed) else math.inf,
        "fastest": float(clean.min()) if len(clean) else math.inf,
        "e_off": float(e_off.mean()),
        "crash_share": float(crashed.mean()),
        "valid_share": float(valid.mean()),
        "off_track": float(off.max()),
        "turn_in": float(led.mean()) if len(led) else math.nan,
    }


def _table(rows: Sequence[Mapping[str, float]]) -> dict[str, Array]:
    return {name: np.array([row[name] for row in rows]) for name in METRICS}


def spread(values: Array) -> list[float] | None:
    """Return the 95 % interval of resampled values; None where more than a tenth have none."""
    known = values[~np.isnan(values)]
    if not len(values) or len(known) < 0.9 * len(values):
        return None
    ends = [(1.0 - LEVEL) / 2.0, (1.0 + LEVEL) / 2.0]
    # between a number and ∞ lies ∞
    low, high = np.quantile(np.clip(known, -BEYOND, BEYOND), ends)
    return [float(each) if abs(each) < 0.01 * BEYOND else math.copysign(math.inf, each) for each in (low, high)]


def ended(interval: list[float] | None) -> list[float] | None:
    """Return an interval that has two ends, else None."""
    return interval if interval and all(map(math.isfinite, interval)) else None


def judge(claim: Claim, sweep: Sweep, samples: Mapping[str, Samples], trial: bool = False) -> dict[str, Any]:
    """Return a claim's verdict, why it is open, and every test's effect and interval; `samples` by car.

    Trainings of a trial budget show effects, but have no verdict (None).
    """
    tests = [_test(test, samples) for test in claim.tests]
    if trial:
        tests = [{**test, "holds": None, "why": test["why"] if test["effect"] is None else TRIAL} for test in tests]
    verdict, why = (None, TRIAL) if trial else weigh(tests)
    facts = {"claim": claim.number, "says": claim.says, "sweep": sweep.name}
    return {**facts, "verdict": verdict, "why": why, "tests": tests}


def weigh(tests: Sequence[Mapping[str, Any]]) -> tuple[str, str]:
    """Return the verdict of tests that must all hold, and why it is open where something stood in the way."""
    outcomes = [test["holds"] for test in tests]
    if False in outcomes:
        return "refuted", ""
    if None not in outcomes:
        return "supported", ""
    reasons = dict.fromkeys(test["why"] for test in tests if test["why"])
    if most := max((test.get("needed") or 0 for test in tests), default=0):
        reasons[power(most)] = None
    tested = any(was_tested(test) for test in tests)
    return "undecided" if tested else "not tested", "; ".join(reasons)


def was_tested(test: Mapping[str, Any]) -> bool:
    """Return whether a test had what it needs."""
    return test["effect"] is not None or bool(test.get("lapless"))


def told(claim: Mapping[str, Any]) -> str:
    """Return a claim's verdict in words, with what kept it open."""
    return ", ".join(filter(None, (claim["verdict"] or "no verdict", claim["why"])))


def obstacle(interval: Sequence[float] | None, trainings: int | None) -> str:
    """Return what keeps a test from being decided, whatever its interval says; nothing where nothing does."""
    if trainings is not None and trainings < 2:
        return f"{trainings} training{'s' * (trainings != 1)}"
    if interval is None:
        return "no value in some resamples"
    same = math.isfinite(interval[0]) and math.isclose(*interval, rel_tol=1e-9, abs_tol=1e-12)
    return "the same in every lap" if same else ""


def needed(effect: float, interval: Sequence[float], limit: Mapping[str, float], trainings: int) -> int:
    """Return how many trainings would decide a test, were its effect as it is and its interval ∝ 1/√trainings.

    At most MANY + 1, which stands for all that are more.
    """
    ((side, bound),) = limit.items()
    bounds = (-bound, bound) if side == "within" else (bound,)
    shares = []  # of the interval's half, that may be left
    for each in bounds:
        reach = effect - interval[0] if each < effect else interval[1] - effect
        distance = abs(effect - each)
        shares.append(distance / reach if math.isfinite(reach) and reach > 0.0 else 0.0)
    if not min(shares) > 0.0:
        return MANY + 1
    return min(max(math.ceil(trainings / min(shares) ** 2), trainings + 1), MANY + 1)


def power(trainings: int) -> str:
    """Return the words for that."""
    return f"about {trainings} trainings would tell" if trainings <= MANY else f"it takes more than {MANY} trainings"


def _test(test: Comparison, samples: Mapping[str, Samples]) -> dict[str, Any]:
    """Return a test's effect, its interval, whether it holds, and what stood in the way."""
    facts: dict[str, Any] = {
        "metric": test.metric,
        "car": test.car,
        "weights": test.weights,
        "slope": dict(test.slope),
        "relative_to": test.relative_to,
        "limit": test.limit,
        "effect": None,
        "ci95": None,
        "seeds": 0,
        "agreeing": 0,
        "holds": None,
        "one_lap": [],
        "lapless": [],
        "why": "",
        "needed": None,
    }
    absent = sorted(arm for arm in test.arms if test.car not in samples or arm not in samples[test.car].per_seed)
    if absent:
        return {**facts, "why": f"{_listed(absent)} {'has' if len(absent) == 1 else 'have'} not been driven"}
    mine = samples[test.car]
    values = {arm: mine.per_seed[arm][test.metric] for arm in sorted(test.arms)}
    lacking = [arm for arm, each in values.items() if np.isnan(each).any() or np.isinf(each).all()]
    if lacking:
        return {**facts, "why": f"{METRICS[test.metric].name}: none for {_listed(lacking)}"}
    if test.relative_to and not mine.value(test.relative_to, test.metric):
        return {
            **facts,
            "why": f"{METRICS[test.metric].name}: 0 for {_listed([test.relative_to])}, nothing to divide by",
        }
    effect = contrast(test, {arm: np.array([mine.value(arm, test.metric)]) for arm in test.arms})[0]
    interval = spread(contrast(test, {arm: mine.resampled[arm][test.metric] for arm in test.arms}))
    single = contrast(test, mine.shared(test.arms, test.metric))
    trainings = mine.trainings(test.arms)
    facts["seeds"] = 0 if trainings is None else len(single)
    facts["one_lap"] = sorted(arm for arm in test.arms if mine.laps[arm] == 1)  # taken as if it were exact
    facts["agreeing"] = sum(test.holds(float(value), float(value)) is True for value in single)
    facts["lapless"] = [arm for arm, each in values.items() if np.isinf(each).any()]
    why = obstacle(interval, trainings)
    holds = None if why or interval is None else test.holds(*interval)
    if why and trainings != 1:
        why = f"{METRICS[test.metric].name}: {why}"
    if facts["lapless"]:  # no number says how much slower that is
        return {**facts, "holds": holds, "why": why or f"{_listed(facts['lapless'])}: trainings without such a lap"}
    if holds is None and not why and interval and trainings:
        facts["needed"] = needed(effect, interval, test.limit, trainings)
    return {**facts, "effect": float(effect), "ci95": ended(interval), "holds": holds, "why": why}


def _listed(arms: Sequence[str]) -> str:
    return " and ".join(arm.replace("_", " ") for arm in arms)


def contrast(test: Comparison, metrics: Mapping[str, Array]) -> Array:
    """Return the contrast of a test from metrics per arm, elementwise."""
    with np.errstate(invalid="ignore"):  # ∞ − ∞: no value
        # what is not trained has one value beside those of the seeds
        total = sum((weight * metrics[arm] for arm, weight in test.weights.items()), np.zeros(1))
        return total / metrics[test.relative_to] if test.relative_to else total
