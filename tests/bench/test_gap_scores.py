"""The blind test's scorer counts what it should."""

import pytest

from racerl.bench.gap import (
    _case,
    _from_the_configured_centre,
    by_verdict,
    calibration,
    confusion,
    detection,
    honest,
    kind_of_car,
    outcome,
    probabilities,
    right,
    scores,
    share,
    wrong_name,
)
from racerl.gap.hypotheses import Rule, hypotheses


def case(
    truth,
    verdict,
    found=(),
    rivals=(),
    kind="single",
    size="medium",
    programme="excitation",
    tells=("a",),
    hypotheses=(),
):
    key = {
        "effects": [
            {"name": name, "size": size, "parameters": {"delay": 0.04}, "units": {"delay": "s"}} for name in truth
        ],
        "set": kind,
        "programme": programme,
        "noise": 1.0,
    }
    delay = {"value": 0.05, "unit": "s", "ci95": [0.039, 0.06]}
    told = {
        "verdict": verdict,
        "effects": [{"name": n, "parameters": {"delay": delay}} for n in found],
        "ambiguous_with": list(rivals),
        "hypotheses": [{"names": list(names), "probability": p} for names, p in hypotheses],
        "separable": list(tells),
        "gap": {"explained": 0.9},
    }
    return outcome("c", key, told, 10.0)


def test_a_name_is_right_only_if_it_is_the_hidden_one_and_the_only_one():
    assert right(case(["a"], "named", ["a"])) and right(case(["a", "b"], "multiple", ["b", "a"], kind="pairs"))
    for other in (("named", ["b"], []), ("multiple", ["a", "b"], []), ("ambiguous", ["a"], ["b"]), ("unknown", [], [])):
        assert not right(case(["a"], *other))
    assert right(case([], "none", kind="clean")) and not right(case([], "named", ["a"], kind="clean"))
    assert wrong_name(case(["a"], "named", ["b"])) and not wrong_name(case(["a"], "ambiguous", ["b"], ["c"]))


def test_scores_count_what_was_said():
    rows = [
        case(["a"], "named", ["a"]),
        case(["a"], "ambiguous", ["b"], ["a"]),
        case(["a"], "named", ["b"], size="small"),
        case(["a"], "none", programme="race", tells=("b",)),
        case([], "none", kind="clean"),
        case([], "ambiguous", ["a"], kind="clean"),
        case(["x"], "unknown", kind="unlisted"),
        case(["a", "b"], "multiple", ["a", "b"], kind="pairs"),
    ]
    found = scores(rows)
    counts = {name: (row["count"], row["of"]) for name, row in found.items() if isinstance(row, dict)}
    assert counts == {
        "right name, medium and large effects on excitation logs": (1, 2),
        "right name, all single effects": (1, 4),
        "right name, where the data are declared to tell": (1, 3),
        "right name, race laps": (0, 1),
        "truth in the reported set": (2, 4),
        "wrong single name": (1, 8),
        "false alarm on clean logs": (1, 2),
        "unknown, effects of no catalogue": (1, 1),
        "both of two effects": (1, 1),
        "true value inside the 95 % interval": (1, 1),
    }
    assert found["mean size of the reported set"] == pytest.approx(4 / 3)
    assert found["parameter error at medium size, median"] == pytest.approx(0.25)
    cells = {(c["programme"], c["size"], c["noise"]): (c["count"], c["of"]) for c in detection(rows)}
    assert cells == {
        ("excitation", "medium", 1.0): (1, 2),
        ("excitation", "small", 1.0): (0, 1),
        ("race", "medium", 1.0): (0, 1),
    }
    trusted = {kind: (row["count"], row["of"]) for kind, row in by_verdict(rows).items()}
    assert trusted == {"ambiguous": (1, 2), "multiple": (1, 1), "named": (1, 2), "none": (1, 2), "unknown": (1, 1)}
    assert confusion(rows)["a"] == {"a": 1, "ambiguous": 1, "b": 1, "none": 1}


def test_where_the_truth_is_withheld_only_what_it_is_confused_with_may_be_said():
    def told(verdict, *said):
        return case(["yaw_damping"], verdict, said[:1], said[1:], kind="withheld")

    right = [told("unknown"), told("named", "locked_differential")]
    wrong = [told("none"), told("named", "lever_arm"), told("ambiguous", "locked_differential", "lever_arm")]
    assert [honest(row) for row in right + wrong] == [True, True, False, False, False]
    found = scores(right + wrong)
    assert "wrong single name" not in found
    row = found["unknown or what it is confused with, truth withheld"]
    assert (row["count"], row["of"]) == (2, 5)
    assert confusion(right + wrong) == {}


def test_places_are_told_from_the_configured_centre_of_gravity():
    effect = {"name": "lever_arm", "parameters": {"forward": 0.02, "left": 0.01}}
    key = {"car": {"l_f": 0.16}, "effects": [effect, {"name": "drive_delay", "parameters": {"forward": 0.02}}]}
    arm, delay = _from_the_configured_centre(key, 0.15)["effects"]  # the hidden car's is 1 cm further back
    assert arm["parameters"] == {"forward": pytest.approx(0.01), "left": 0.01} and arm["name"] == "lever_arm"
    assert delay["parameters"] == {"forward": 0.02} and effect["parameters"]["forward"] == 0.02
    assert _from_the_configured_centre({"effects": [effect]}, 0.15) == {"effects": [effect]}


def test_wilson_intervals():
    row = share(50, 50)  # 1 − z²/(n + z²)
    assert row["ci95"] == pytest.approx([50 / (50 + 1.96**2), 1.0])
    half = share(5, 10)
    assert half["ci95"][0] == pytest.approx(0.2366, abs=1e-4) and sum(half["ci95"]) == pytest.approx(1.0)


def test_probabilities_are_scored_by_how_often_they_are_right(monkeypatch):
    monkeypatch.setattr("racerl.bench.gap.calibrated_least", lambda: 0.1)
    damping, lag = "yaw_damping", "drive_delay"
    sure, wide = [((damping,), 0.97), ((), 0.03)], [((damping,), 0.5), ((lag,), 0.3), (("?",), 0.2)]
    rows = [
        case([damping], "named", [damping], hypotheses=sure),
        case([lag], "ambiguous", [damping], [lag], hypotheses=wide),
        case(["fluttering_tyre"], "unknown", kind="unlisted", hypotheses=wide),
        case([], "named", [damping], kind="clean", hypotheses=[((damping,), 1.0)]),
        case([damping], "unknown", kind="withheld", hypotheses=sure),
        case([], "under_excited", kind="poor"),
    ]
    found = probabilities(rows)
    assert found["cases"] == 4 and found["covered"] == 0.75 and found["first"] == 0.25
    assert found["size"] == pytest.approx((1 + 3 + 3 + 1) / 4)
    assert found["error"] == pytest.approx((abs(2 * 0.5) + abs(1.97 - 1.0)) / 4)  # two bins of five
    assert (found["one_cases"], found["one_covered"], found["one_size"]) == (2, 1.0, 2.0)
    assert probabilities([case([], "none", kind="clean")]) == {}
    assert probabilities([case([], "none", kind="clean", hypotheses=[((), 1.0)])])["one_covered"] is None


def test_cars_with_other_sensors_or_wheels_are_of_another_kind():
    """Rules are judged on a kind of car that they were not fitted to; keys of before know of neither."""
    key = {"tyre": "brush", "slip": "surface"}
    usual = {**key, "sensors": "ideal", "structure": "single_track"}
    assert kind_of_car(key) == kind_of_car(usual) == "brush, surface"
    assert kind_of_car({**key, "sensors": "bent"}) == "brush, surface, bent"
    assert kind_of_car({**usual, "structure": "ackermann"}) == "brush, surface, ackermann"


def test_a_rule_is_fitted_to_what_the_rounds_of_cases_saw():
    row = {"name": "yaw_damping", "needed": True, "gain": 9.0, "error": 1.0, "explained": 0.9, "fall": 0.5}
    row |= {"behind": 0.0, "leads": 1.0, "like": 0.0}
    left = {"held_out": {"chassis": 0.01}, "fit": {"chassis": 0.01}, "candidates": []}
    seen = [{"held_out": {"chassis": 0.6}, "fit": {"chassis": 0.6}, "candidates": [row]}, left]
    hides = [_case(["yaw_damping"], seen), _case([], [left])]
    assert [case.hidden for case in hides] == [{"yaw_damping"}, set()] and not hides[0].unlisted
    assert _case(["fluttering_tyre"], [left]).unlisted
    table = calibration(hides * 6, ["brush, centre", "dugoff, larger"] * 6)
    assert table["cases"] == {"brush, centre": 6, "dugoff, larger": 6}
    assert hypotheses(seen, Rule.of(table["weights"]))[0].names == ("yaw_damping",)
    assert hypotheses([left], Rule.of(table["weights"]))[0].names == ()
    assert table["left_out_groups"]["cases"] == 12 and table["least"] == 0.0  # six cases do not tell 95 %
