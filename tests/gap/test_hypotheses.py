"""Probabilities of what may be hidden, on rounds made up by hand, and the rule that is fitted to them."""

import numpy as np
import pytest

from racerl.gap.calibration import Case, calibrate, checked, choices, compared, conformal
from racerl.gap.hypotheses import (
    CANDIDATE,
    LEFT,
    STOP,
    UNLISTED,
    Hypothesis,
    Rule,
    candidate_features,
    choice,
    credible,
    hypotheses,
    in_doubt,
    left_features,
    stop_features,
)
from racerl.gap.sentences import in_short, likely, unseen, why_not


def candidate(name, errors=5.0, explained=0.9, fall=0.5, behind=0.0, leads=1.0, like=0.0):
    row = {"name": name, "needed": errors > 3.0, "gain": errors, "error": 1.0, "explained": explained, "fall": fall}
    return {**row, "behind": behind, "leads": leads, "like": like}


def seen(excess, *candidates):
    return {"held_out": {"chassis": excess}, "fit": {"chassis": excess}, "candidates": list(candidates)}


def rule(stop=0.0, left=(-3.0, 0.0, 0.0), **weights):
    own = np.array([weights.get(name, 0.0) for name in CANDIDATE])
    return Rule(own, np.full(len(STOP), stop), np.array(left))


def test_odds_are_those_of_the_weighted_features():
    each = seen(1.0, candidate("a", explained=0.9), candidate("b", explained=0.2))
    p = choice(each, rule(explained=2.0))
    assert p.sum() == pytest.approx(1.0)
    assert np.log(p[1:] / p[0]) == pytest.approx([1.8, 0.4])  # nothing is given for an end of the search
    assert choice(seen(1.0), rule()) == pytest.approx([1.0])


def test_candidates_are_in_doubt_where_none_of_them_is_more_probable():
    each = seen(0.9, candidate("a", explained=0.9), candidate("b", explained=0.2))
    assert not in_doubt(each, rule(explained=2.0))
    assert not in_doubt(each, rule(constant=-0.6))  # a or b, no matter which
    assert in_doubt(each, rule(constant=-0.8)) and in_doubt(seen(0.9), rule(explained=2.0))
    assert not in_doubt({**each, "fit": {"chassis": 2.0}}, rule(constant=-0.8))  # something is missing there


def test_a_path_multiplies_its_rounds():
    rounds = [seen(1.0, candidate("a"), candidate("b")), seen(0.1, candidate("c"))]
    told = {each.names: each.probability for each in hypotheses(rounds, rule())}
    missing = 1.0 / (1.0 + np.exp(3.0))
    assert sum(told.values()) == pytest.approx(1.0, abs=0.02)
    # a, b and none are alike; behind a or b, c or none
    assert told[()] == pytest.approx((1 - missing) * (1 / 3) / (1 / 3 + 3 * 1 / 6), rel=1e-6)
    assert told["a",] == pytest.approx(told["b",]) and told["a", "c"] == pytest.approx(told["a",])
    assert told["?", "a"] == pytest.approx(told["a",] * missing / (1 - missing))


def test_what_is_left_is_of_no_catalogue_where_the_weights_say_so():
    rounds = [seen(4.0, candidate("a")), seen(3.0, candidate("c", errors=0.0, explained=0.0))]
    told = hypotheses(rounds, rule(left=(-4.0, 2.0, 0.0), explained=3.0))
    assert UNLISTED in told[0].names
    assert UNLISTED not in hypotheses(rounds, rule(left=(-4.0, 0.0, 0.0), explained=3.0))[0].names


def drawn(true, number, seed):
    """Return cases with one hidden effect, nothing or something unlisted, as a rule would have them."""
    generator, cases = np.random.default_rng(seed), []
    for _ in range(number):
        excess = float(np.exp(generator.normal(-1.0, 1.0)))
        shares = np.sort(generator.uniform(0.0, 1.0, 3))[::-1]
        rows = [
            candidate(name, 5.0 * share, share, share * excess, 4.0 * i, max(1.0 - 0.4 * i, 0.0))
            for i, (name, share) in enumerate(zip("abc", shares, strict=True))
        ]
        each = seen(excess, *rows)
        right = int(generator.choice(4, p=choice(each, true)))
        unlisted = generator.uniform() < 1.0 / (1.0 + np.exp(-true.left @ left_features([each])))
        cases.append(Case(frozenset("abc"[right - 1 : right]) if right else frozenset(), bool(unlisted), [each]))
    return cases


def test_a_rule_is_found_again_from_what_it_led_to():
    true = rule(stop=1.0, left=(-3.0, 1.0, 0.5), constant=-1.0, errors=1.0, explained=2.0, fall=0.5, behind=-0.3)
    found = calibrate(drawn(true, 500, seed=0))
    fresh = drawn(true, 300, seed=1)
    for known in (lambda r, case: choice(case.rounds[0], r), lambda r, case: [r.left @ left_features(case.rounds)]):
        wanted, had = (np.concatenate([known(r, case) for case in fresh]) for r in (true, found))
        assert np.corrcoef(wanted, had)[0, 1] > 0.97
    p = np.array([choice(case.rounds[0], found) for case in fresh])
    right = np.array([[not case.hidden, *(name in case.hidden for name in "abc")] for case in fresh])
    for low, high in ((0.0, 0.2), (0.2, 0.5), (0.5, 1.0)):  # as often right as it says
        inside = (p >= low) & (p < high)
        assert right[inside].mean() == pytest.approx(p[inside].mean(), abs=0.08)


def test_sets_hold_one_effect_as_often_as_they_should_in_cars_not_seen():
    told = [Hypothesis((name,), p) for name, p in (("a", 0.9), ("b", 0.06), ("c", 0.04))]
    assert [len(credible(told, least)) for least in (1.0, 0.9, 0.06, 0.05, 0.04, 0.0)] == [1, 1, 2, 2, 3, 3]
    generator, levels = np.random.default_rng(0), []

    def drawn_at_random(count):  # probabilities that promise too much: the truth is further down than they say
        rows, truths = [], []
        for p in generator.dirichlet([4.0, 1.0, 1.0, 1.0], count):
            p = np.sort(p)[::-1]
            rows.append([Hypothesis((name,), float(each)) for name, each in zip("abcd", p, strict=True)])
            truths.append(("abcd"[generator.choice(4, p=np.sqrt(p) / np.sqrt(p).sum())],))
        return rows, truths

    for _ in range(100):
        least = conformal(*drawn_at_random(100))
        levels.append(compared(*drawn_at_random(1000), least).one_covered)
    assert np.mean(np.array(levels) > 0.94) > 0.85 and 0.96 < np.mean(levels) < 0.985
    rows, truths = drawn_at_random(60)
    assert conformal(rows[:44], truths[:44]) == 0.0 < conformal(rows[:45], truths[:45]), "of 44 none may be missed"
    assert conformal(rows, [("elsewhere",), *truths[1:]]) == 0.0, "what was not told needs all that was"
    assert conformal(rows, [("a", "b")] * 60) == 0.0, "of cars that lack one effect"


def test_groups_are_judged_by_rules_of_others():
    true = rule(stop=2.0, left=(-4.0, 0.0, 0.0), constant=-1.0, errors=1.0, explained=2.0, fall=1.5, behind=-0.6)
    _, found = checked(drawn(true, 300, seed=0), ["one", "two", "three"] * 100)
    assert found.cases == 300 and 0.9 < found.covered <= 1.0 and found.error < 0.06
    assert 1.0 <= found.size <= 4.0 and found.first > 0.5
    assert 0.02 < found.chance < 0.05 and found.error < 2.0 * found.chance  # no further off than right ones would be
    lost = [Case(case.hidden, not case.unlisted, case.rounds) for case in drawn(true, 60, seed=1)]
    _, mixed = checked([*drawn(true, 60, seed=0), *lost], ["right"] * 60 + ["wrong"] * 60)
    assert mixed.covered < 0.6 and mixed.error > 3.0 * mixed.chance  # what no other group had shown


def test_rounds_behind_a_wrong_addition_teach_nothing():
    rounds = [seen(1.0, candidate("wrong"), candidate("a")), seen(0.5, candidate("a"))]
    only = list(choices(Case(frozenset("a"), False, rounds)))
    assert len(only) == 1 and only[0].right.tolist() == [False, False, True]
    both = list(choices(Case(frozenset({"wrong", "a"}), False, rounds)))
    assert [each.right.tolist() for each in both] == [[False, True, True], [False, True]]
    lost = list(choices(Case(frozenset({"elsewhere"}), False, rounds)))
    assert lost[0].right.tolist() == [True, False, False]  # none of these


def test_features_are_finite_whatever_a_round_saw():
    row = {**candidate("a", errors=-1.0, explained=-3.0, fall=-0.1, behind=50.0, leads=0.0), "error": 0.0}
    for each in (seen(-0.1, row), seen(0.0)):
        assert np.isfinite(candidate_features(each)).all() and np.isfinite(stop_features(each)).all()
        assert np.isfinite(left_features([each])).all() and left_features([each]).shape == (len(LEFT),)


def test_weights_come_back_from_their_table():
    true = rule(stop=1.0, errors=0.5)
    again = Rule.of(true.weights())
    assert all((a == b).all() for a, b in zip(true, again, strict=True))


def test_why_a_runner_up_lost_is_told():
    ranking = [{"name": n, "explained": e, "behind": b} for n, e, b in (("a", 0.9, 0.0), ("b_c", 0.6, 3.4))]
    named = [["a"], ["b_c"], [], ["?"], ["?", "a"], ["b_c", "d"]]
    facts = {"ranking": ranking, "hypotheses": [{"names": each} for each in named], "effects": [{"name": "a"}]}
    facts |= {"helped": [], "gap": {"before": 2.5, "after": 1.02}}
    first, second, nothing, other, more, pair = (why_not(facts, each) for each in facts["hypotheses"])
    assert second == "explains 60% of the excess, a 90%; 3.4 standard errors behind on held-out windows"
    assert nothing == "refitted without any effect the error stays at 2.50 times the sensors' noise"
    assert more == "without more the error is at 1.02 times the sensors' noise"
    assert first == other == pair == ""
    alone = facts | {"hypotheses": [{"names": ["?", "a"]}, {"names": ["a"]}], "effects": [], "helped": [{"name": "a"}]}
    assert why_not(alone, alone["hypotheses"][1]) == "with that alone the error stays at 1.02 times the sensors' noise"
    assert why_not(facts | {"gap": None}, facts["hypotheses"][2]) == ""


def test_the_likeliest_and_what_would_not_show_are_told_in_a_line():
    rows = [{"names": names, "probability": p} for names, p in ((["?", "b_c"], 0.9), ([], 0.08), (["a"], 0.004))]
    assert likely({"hypotheses": rows}) == "b c and something not in the catalogue 90%; nothing 8%"
    assert likely({"hypotheses": []}) == "" and in_short(rows[1]) == "nothing"
    assert unseen({"blind_to": []}) == "" and unseen({"blind_to": ["a", "b"]}).endswith("size: a and b")
    assert unseen({"blind_to": list("abcdefg")}).endswith("7 effects (the report has them)")
