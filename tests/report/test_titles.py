"""The titles of pages whose facts come from other stages."""

import pytest

from racerl.gap.sentences import headline, opening
from racerl.report import log_page


def effect(name, **values):
    parameters = {key: {"value": v, "unit": unit, "ci95": [v - 0.1, v + 0.1]} for key, (v, unit) in values.items()}
    return {"name": name, "parameters": parameters}


DAMPED, ASIDE = (
    effect("yaw_damping", coefficient=(0.4, "N m s")),
    effect("lever_arm", forward=(0.2, "m"), left=(0.1, "m")),
)
GRIP = {"parameter": "friction", "what": "grip of the floor", "from": 0.8, "to": 0.5, "ci95": [0.49, 0.51]}
GRIP |= {"explained": 0.98, "stages": ["chassis"]}
DAMPED_TOLD = "Your car resists turning: yaw damping 0.4 N m s (0.3 … 0.5)."
FALLS = "With that the error falls from 2.20 to 1.00 times the sensors' noise."


@pytest.mark.parametrize(
    "verdict, effects, rivals, changes, title, lines",
    [
        ("named", [DAMPED], [], [], "Your car resists turning", [DAMPED_TOLD, FALLS]),
        (
            "multiple",
            [DAMPED, ASIDE],
            [],
            [],
            "Your car resists turning, and the point that is tracked is not your car's centre of gravity",
            [
                DAMPED_TOLD,
                "The point that is tracked is not your car's centre of gravity: lever arm forward 0.2 m (0.1 … 0.3), "
                "left 0.1 m (0 … 0.2).",
                FALLS,
            ],
        ),
        (
            "ambiguous",
            [DAMPED],
            ["tyre_relaxation"],
            [],
            "Your car resists turning; or your tyres need a distance to build up side force",
            [
                DAMPED_TOLD,
                "This log cannot distinguish that from: "
                "your tyres need a distance to build up side force (tyre relaxation).",
                FALLS,
            ],
        ),
        ("unknown", [], [], [], *2 * ["Something real is missing that no known effect explains"]),
        ("under_excited", [], [], [], *2 * ["This log cannot tell what is missing"]),
        ("none", [], [], [], *2 * ["Nothing is missing: the refitted vehicle reaches the noise"]),
        (
            "none",
            [],
            [],
            [GRIP],
            "Grip of the floor: 38% less than configured",
            [
                "Grip of the floor: 38% less than configured, friction 0.5 (0.49 … 0.51) instead of 0.8; "
                "this explains 98% of the error of the vehicle as configured, in the motion."
            ],
        ),
    ],
)
def test_every_verdict_of_a_gap_is_a_sentence(verdict, effects, rivals, changes, title, lines):
    facts = {
        "verdict": verdict,
        "effects": effects,
        "ambiguous_with": rivals,
        "configured": {"changes": changes, "rest": 0.0},
        "gap": {"before": 2.2, "after": 1.0, "explained": 1.0},
        "reason": "the refitted vehicle reaches the noise",
    }
    assert headline(facts) == title
    assert opening(facts) == ([f"{lines}."] if isinstance(lines, str) else lines)
    assert opening({**facts, "gap": None})  # nothing could be driven
    mostly = {**facts, "gap": {"before": 26.2, "after": 24.3, "explained": 0.13}}
    assert opening(mostly)[-1].startswith("Most of the gap remains unexplained") == bool(effects)


def test_logs_are_told_by_their_length_and_their_traps():
    log = {"seconds": 90.0, "warnings": ["a lag"]}
    assert log_page.headline({"logs": [log], "warnings": []}) == "90 s of driving in 1 log, 1 warning"
    two = {"logs": [{**log, "warnings": []}] * 2, "warnings": []}
    assert log_page.headline(two) == "3.0 min of driving in 2 logs, no warnings"
