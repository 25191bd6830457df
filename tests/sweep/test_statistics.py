"""From laps to verdicts, on laps whose truth is known."""

import json
import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from racerl.sweep import statistics
from racerl.sweep.definition import Claim, Comparison, Sweep
from racerl.sweep.jobs import UNTRAINED
from racerl.sweep.measures import STEP, arrivals, final_reward, turn_in
from racerl.sweep.statistics import MANY, contrast, judge, needed, resample, spread, told, weigh

SLOWER = Comparison(metric="lap_time", contrast={"b": 1.0, "a": -1.0}, above=0.0)


@pytest.fixture(autouse=True)
def few_resamples(monkeypatch):
    monkeypatch.setattr(statistics, "RESAMPLES", 200)


def driven(means, seeds=3, laps=20, seed_spread=0.1, lap_spread=0.02, draw=0):
    """Return laps and trainings of arms whose mean lap time is known; a seed's luck is common to all arms."""
    generator = np.random.default_rng(draw)
    luck = generator.normal(0.0, seed_spread, seeds)
    rows, trainings = [], []
    for arm, mean in means.items():
        for seed in range(seeds):
            trainings.append({"arm": arm, "seed": seed, "reward": 0.1 * mean})
            for start in range(3):
                for number in range(laps):
                    time = mean + luck[seed] + generator.normal(0.0, lap_spread)
                    rows.append(
                        {
                            "arm": arm,
                            "seed": seed,
                            "start": start,
                            "number": number,
                            "time_s": time,
                            "e_off": 0.001,
                            "off_track_m": 0.0,
                            "crashed": False,
                            "valid": number % 2 == 0,
                            "turn_in_m": 0.1,
                        }
                    )
    return pd.DataFrame(rows), pd.DataFrame(trainings)


def verdict(test, laps, trainings, *more, trial=False):
    sweep = Sweep("s", "?", (), dict.fromkeys(laps["arm"].unique(), ()), (0, 1, 2), ("lap_time",), ())
    samples = {"twin": resample(laps, trainings, np.random.default_rng(0))}
    return judge(Claim(1, "b is slower", (test, *more)), sweep, samples, trial)


@pytest.mark.parametrize("difference, expected", [(0.2, "supported"), (-0.2, "refuted"), (0.0, "undecided")])
def test_a_claim_is_decided_by_the_truth(difference, expected):
    found = verdict(SLOWER, *driven({"a": 5.5, "b": 5.5 + difference}, draw=1))
    assert found["verdict"] == expected
    low, high = found["tests"][0]["ci95"]
    assert low <= found["tests"][0]["effect"] <= high


def test_luck_that_arms_share_does_not_count():
    laps, trainings = driven({"a": 5.5, "b": 5.55}, seed_spread=0.5)
    samples = resample(laps, trainings, np.random.default_rng(0))
    alone = np.diff(samples.interval("a", "lap_time"))[0]
    apart = np.diff(spread(contrast(SLOWER, {arm: samples.resampled[arm]["lap_time"] for arm in "ab"})))[0]
    assert apart < 0.05 * alone


@pytest.mark.slow
def test_intervals_hold_the_truth_about_as_often_as_they_say():
    inside = 0
    for draw in range(40):
        samples = resample(*driven({"a": 5.5}, seeds=10, laps=4, draw=draw), np.random.default_rng(draw))
        low, high = samples.interval("a", "lap_time")
        inside += low <= 5.5 <= high
    assert inside >= 33  # 95 % of 40 is 38; ten seeds make them somewhat narrow


def test_the_metrics_are_those_of_the_laps():
    laps, trainings = driven({"a": 5.5}, seed_spread=0.0, lap_spread=0.0)
    laps.loc[(laps["number"] == 0), ["time_s", "crashed", "valid", "off_track_m"]] = [np.nan, True, False, 0.3]
    samples = resample(laps, trainings, np.random.default_rng(0))
    assert samples.value("a", "lap_time") == pytest.approx(5.5) and samples.value("a", "fastest") == pytest.approx(5.5)
    assert samples.value("a", "crash_share") == pytest.approx(1 / 20)
    assert samples.value("a", "valid_share") == pytest.approx(9 / 20)
    assert samples.value("a", "off_track") == pytest.approx(0.3)
    assert samples.value("a", "reward") == pytest.approx(0.55)


def test_what_was_never_finished_leaves_a_claim_open():
    laps, trainings = driven({"a": 5.5, "b": 6.0})
    laps.loc[laps["arm"] == "b", "time_s"] = np.nan
    found = verdict(SLOWER, laps, trainings)
    assert found["verdict"] == "not tested" and "none for b" in found["tests"][0]["why"]


@pytest.mark.parametrize(("difference", "expected"), [(0.2, "supported"), (-0.2, "undecided")])
def test_a_training_without_a_lap_to_time_is_slower_than_the_others(difference, expected):
    laps, trainings = driven({"a": 5.5, "b": 5.5 + difference})
    laps.loc[(laps["arm"] == "b") & (laps["seed"] == 1), "valid"] = False
    fastest = replace(SLOWER, metric="fastest")
    found = verdict(fastest, laps, trainings)
    assert found["verdict"] == expected  # against b: all that resamples without it say, else only its failure
    test = found["tests"][0]
    assert test["lapless"] == ["b"] and test["effect"] is None and test["ci95"] is None
    assert resample(laps, trainings, np.random.default_rng(0)).interval("b", "fastest") is None
    laps.loc[(laps["arm"] == "a") & (laps["seed"] == 1), "valid"] = False  # nor has the other
    both = verdict(fastest, laps, trainings)
    assert both["verdict"] == "undecided" and both["tests"][0]["lapless"] == ["a", "b"]
    laps.loc[laps["arm"] == "b", "valid"] = False
    assert verdict(fastest, laps, trainings)["verdict"] == "not tested"


def test_the_only_lap_to_time_leaves_an_interval_without_an_end():
    laps, trainings = driven({"a": 5.5, "b": 5.7})
    laps.loc[(laps["arm"] == "b") & ((laps["number"] > 0) | (laps["start"] > 0)), "valid"] = False
    found = verdict(replace(SLOWER, metric="fastest"), laps, trainings)
    test = found["tests"][0]  # each training's only clean lap is missed by a third of the resamples and more
    assert found["verdict"] == "supported" and test["ci95"] is None and test["effect"] == pytest.approx(0.2, abs=0.05)


def test_what_was_never_driven_leaves_a_claim_open():
    found = verdict(Comparison(metric="lap_time", contrast={"a": 1.0, "mpc": -1.0}, below=0.0), *driven({"a": 5.5}))
    assert found["verdict"] == "not tested" and found["tests"][0]["why"] == "mpc has not been driven"


@pytest.mark.parametrize("difference", [0.2, -0.2])
def test_one_training_decides_nothing_however_narrow_its_interval(difference):
    found = verdict(SLOWER, *driven({"a": 5.5, "b": 5.5 + difference}, seeds=1, lap_spread=0.01))
    low, high = found["tests"][0]["ci95"]
    assert high - low < 0.02 and found["verdict"] == "undecided" and told(found) == "undecided, 1 training"


def test_the_least_trained_arm_counts_and_what_is_not_trained_does_not():
    laps, trainings = driven({"a": 5.5, "b": 5.7})
    only = laps["seed"].isin([0]) | (laps["arm"] == "a"), trainings["seed"].isin([0]) | (trainings["arm"] == "a")
    assert told(verdict(SLOWER, laps[only[0]], trainings[only[1]])) == "undecided, 1 training"
    one = (laps["seed"] == 0) & (laps["arm"] == "b"), (trainings["seed"] == 0) & (trainings["arm"] == "b")
    rival = laps[one[0]].assign(seed=UNTRAINED), trainings[one[1]].assign(seed=UNTRAINED)
    mixed = [
        pd.concat([whole[whole["arm"] == "a"], part]) for whole, part in zip((laps, trainings), rival, strict=True)
    ]
    assert verdict(SLOWER, *mixed)["verdict"] == "supported"


def test_trainings_that_agree_are_counted_among_those_that_can():
    laps, trainings = driven({"a": 5.5, "b": 5.7})
    assert verdict(SLOWER, laps, trainings)["tests"][0]["seeds"] == 3
    kept = (laps["arm"] == "a") | (laps["seed"] > 0), (trainings["arm"] == "a") | (trainings["seed"] > 0)
    assert verdict(SLOWER, laps[kept[0]], trainings[kept[1]])["tests"][0]["seeds"] == 2
    first = laps["seed"] == 0, trainings["seed"] == 0
    untrained = laps[first[0]].assign(seed=UNTRAINED), trainings[first[1]].assign(seed=UNTRAINED)
    assert verdict(SLOWER, *untrained)["tests"][0]["seeds"] == 0


def test_nothing_is_divided_by_an_arm_that_has_none_of_it():
    laps, trainings = driven({"a": 5.5, "b": 5.7})
    laps.loc[laps["arm"] == "a", "e_off"] = 0.0
    worse = Comparison(metric="e_off", contrast={"b": 1.0, "a": -1.0}, relative_to="a", above=0.1)
    test = verdict(worse, laps, trainings)["tests"][0]
    assert test["effect"] is None and test["why"] == "E_off: 0 for a, nothing to divide by"
    json.dumps(test, allow_nan=False)


@pytest.mark.parametrize("difference", [0.2, -0.2])
def test_an_interval_without_width_decides_nothing(difference):
    found = verdict(SLOWER, *driven({"a": 5.5, "b": 5.5 + difference}, seed_spread=0.0, lap_spread=0.0))
    assert told(found) == "undecided, mean lap: the same in every lap" and found["tests"][0]["holds"] is None


@pytest.mark.parametrize("difference", [0.2, -0.2])
def test_a_trial_shows_effects_and_no_verdict(difference):
    found = verdict(SLOWER, *driven({"a": 5.5, "b": 5.5 + difference}), trial=True)
    assert found["verdict"] is None and told(found) == "no verdict, trial budget"
    assert found["tests"][0]["holds"] is None and found["tests"][0]["effect"] == pytest.approx(difference, abs=0.05)


def test_a_claim_of_which_one_part_was_tested_is_open_or_refuted_by_that_part():
    undriven = Comparison(metric="lap_time", contrast={"a": 1.0, "mpc": -1.0}, below=0.0)
    assert verdict(SLOWER, *driven({"a": 5.5, "b": 5.8}), undriven)["verdict"] == "undecided"
    assert verdict(SLOWER, *driven({"a": 5.5, "b": 5.2}), undriven)["verdict"] == "refuted"


def test_drawn_twice_is_drawn_alike():
    laps, trainings = driven({"a": 5.5, "b": 5.6})
    assert verdict(SLOWER, laps, trainings) == verdict(SLOWER, laps, trainings)


@pytest.mark.parametrize("metres", [-0.83, -0.1, 0.0, 0.37, 1.2])
def test_turn_in_is_the_lead_of_the_steering(metres):
    s = np.arange(0.0, 17.5, STEP)

    def bends(at):
        return sum(np.exp(-0.5 * (((s - place - at + 8.75) % 17.5 - 8.75) / 0.8) ** 2) for place in (2.0, 7.5, 11.0))

    assert turn_in(0.4 * bends(-metres), bends(0.0)) == pytest.approx(metres, abs=0.01)


def test_the_reward_is_that_of_the_end():
    steps = np.arange(1, 101)
    assert final_reward(pd.DataFrame({"steps": steps, "reward": np.where(steps >= 90, 0.5, 0.0)})) == 0.5
    assert final_reward(pd.DataFrame({"steps": [], "reward": []})) is None


def test_a_policy_arrives_with_its_first_examination_that_is_near_enough_and_without_a_crash(tmp_path):
    raced, trained = tmp_path / "raced", tmp_path / "trained"
    raced.mkdir()
    trained.mkdir()
    (raced / "metrics.json").write_text(json.dumps({"optimum_s": 5.0}))
    examined = [(10, 5.6, 0.0), (20, 5.2, 0.5), (30, 5.3, 0.0), (40, None, 1.0), (50, 5.12, 0.0), (60, 5.2, 0.0)]
    lines = [
        {"steps": second, "time/seconds": second, "evaluation/settled_lap_s": lap, "evaluation/crash_share": crashed}
        for second, lap, crashed in examined
    ]
    (trained / "progress.jsonl").write_text("".join(json.dumps(line) + "\n" for line in [{"steps": 1}, *lines]))
    cars = {("learned", "twin"): None, ("learned", "model"): None}
    job = SimpleNamespace(race=lambda policy, car: raced, trained=trained, train={}, races=cars)
    found = arrivals(job, "learned")
    assert found["to_10"] == 30.0 and found["to_3"] == 50.0 and math.isnan(found["to_2"])
    for change in ({"races": {("learned", "twin"): None}}, {"train": None}):
        assert all(
            math.isnan(seconds) for seconds in arrivals(SimpleNamespace(**{**vars(job), **change}), "learned").values()
        )


@pytest.mark.parametrize(
    ("effect", "interval", "limit", "trainings"),
    [
        (0.1, [-0.1, 0.3], {"above": 0.0}, 20),  # half of the interval may be left: 5 / ½²
        (0.1, [-0.3, 0.2], {"above": 0.0}, 80),  # the side of the threshold counts
        (-0.1, [-0.3, 0.1], {"above": 0.0}, 20),
        (0.02, [-0.15, 0.09], {"within": 0.1}, 11),  # inside, the further bound counts: −0.12 of −0.17
        (0.3, [0.05, 0.4], {"within": 0.1}, 8),  # outside, the near one alone
        (0.1, [0.0, 0.3], {"above": 0.0}, 6),  # one more at least
        (0.0, [-0.1, 0.1], {"above": 0.0}, MANY + 1),
        (0.1, [-math.inf, 0.3], {"above": 0.0}, MANY + 1),
    ],
)
def test_how_many_trainings_would_tell(effect, interval, limit, trainings):
    assert needed(effect, interval, limit, 5) == trainings


def test_an_open_claim_says_what_its_least_sure_test_needs():
    opened = [{"holds": None, "effect": 1.0, "why": "", "needed": count} for count in (6, 12)]
    assert weigh([*opened, {"holds": True, "effect": 1.0, "why": "", "needed": None}]) == (
        "undecided",
        "about 12 trainings would tell",
    )
    far = {"holds": None, "effect": 1.0, "why": "", "needed": MANY + 1}
    assert weigh([*opened, far])[1] == f"it takes more than {MANY} trainings"


def test_what_a_policy_as_learned_arrived_at_came_before_its_refinement(tmp_path):
    raced, trained = tmp_path / "raced", tmp_path / "trained"
    raced.mkdir()
    (trained / "unrefined").mkdir(parents=True)
    (raced / "metrics.json").write_text(json.dumps({"optimum_s": 5.0}))
    (trained / "unrefined" / "policy.json").write_text(json.dumps({"learned": {"steps": 20}}))
    lines = [
        {"steps": step, "time/seconds": float(step), "evaluation/settled_lap_s": lap, "evaluation/crash_share": 0.0}
        for step, lap in ((10, 5.6), (20, 5.4), (30, 5.2))
    ]
    (trained / "progress.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    races = {("learned", "model"): None, ("refined", "model"): None}
    job = SimpleNamespace(race=lambda policy, car: raced, trained=trained, train={}, races=races)
    learned, refined = arrivals(job, "learned"), arrivals(job, "refined")
    assert learned["to_10"] == refined["to_10"] == 20.0
    assert math.isnan(learned["to_5"]) and refined["to_5"] == 30.0
