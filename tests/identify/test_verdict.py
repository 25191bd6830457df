"""The verdict: usable or not, why, and the one command to go on with."""

import json

import pytest

from racerl.identify.verdict import judge


def facts_of(after, before=1.0, still=9.0, fitted=True, converged=True, held_out="nothing", told=9, wrong=()):
    """What a verdict is made of: errors of one channel at one horizon."""

    def errors(value):
        return None if value is ... else {"85": {"v_x": value, "yaw_rate": 1.0}}

    facts = {
        "contradictions": wrong,
        "fitted": fitted,
        "horizon": 85,
        "rmse": errors(after),
        "rmse_hold_last_state": errors(still),
    }
    fit = {"rmse_unfitted": errors(before), "held_out": held_out, "method": {"converged": converged}}
    fit["open"] = {"told": told}
    return facts | (fit if fitted else {})


@pytest.mark.parametrize(
    "case, because, following",
    [
        ({"after": 1.3}, "grew: v_x × 1.30", "racerl gap LOG"),
        ({"after": None}, "v_x diverge", "racerl gap LOG"),
        ({"after": ...}, "no run was held out", "racerl identify LOG"),
        (
            {"after": ..., "held_out": "nothing: the log is too short"},
            "out: the log is too short",
            "racerl gap plan LOG",
        ),
        ({"after": 0.9, "converged": False}, "not converged", "racerl identify LOG method.iterations=300"),
        ({"after": 0.9, "told": 0}, "tells no number of the car", "racerl gap plan LOG"),
        ({"after": 0.9, "still": 0.8}, "holding the first value errs less: v_x", "racerl gap LOG"),
        ({"after": 1.0, "still": 0.8, "fitted": False}, "errs less: v_x", "racerl identify LOG"),
        ({"after": 0.5, "wrong": ["a.csv: yaw in deg?"]}, "contradicts itself: a.csv: yaw in deg?", "racerl data LOG"),
    ],
)
def test_not_usable(case, because, following):
    verdict = judge(facts_of(**case))
    assert not verdict["usable"] and because in verdict["because"] and verdict["next"] == following


def test_usable():
    verdict = judge(facts_of(0.5))
    assert verdict["usable"] and "0.50 to 1.00 of those before" in verdict["because"]
    assert verdict["next"] == "racerl train vehicle=MODEL"
    assert judge(facts_of(1.0, fitted=False))["next"] == "racerl train VEHICLE"
    assert judge(facts_of(1.015))["usable"], "a change within the scatter is none"


def test_errors_that_grow_are_named_first(lacking):
    first = lacking.facts["warnings"][0]
    row = lacking.facts["verdict"]["channels"]["v_x"]
    assert row["factor"] > 1.1 and first.startswith(f"v_x errs {row['factor']:.2f} times as much as before")
    written = json.loads((lacking.out / "identification.json").read_text())
    assert written["verdict"] == lacking.facts["verdict"] and not written["verdict"]["usable"]
