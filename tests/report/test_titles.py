"""The titles of pages whose facts come from other stages."""

import pytest

from racerl.report import gap_page, log_page

EFFECTS = [{"name": "yaw_damping"}, {"name": "steering_gain"}]


@pytest.mark.parametrize(
    "verdict, effects, rivals, title",
    [
        ("named", 1, [], "The model misses yaw damping: it explains 98% of the gap"),
        ("multiple", 2, [], "The model misses yaw damping and steering gain: together they explain 98% of the gap"),
        ("ambiguous", 1, ["tyre_relaxation"], "The model misses yaw damping, or tyre relaxation"),
        ("unknown", 0, [], "Something real is missing that no known effect explains"),
        ("none", 0, [], "Nothing is missing: the refitted vehicle reaches the noise"),
        ("under_excited", 0, [], "This log cannot tell what is missing"),
    ],
)
def test_every_verdict_of_a_gap_is_a_sentence(verdict, effects, rivals, title):
    facts = {"verdict": verdict, "effects": EFFECTS[:effects], "ambiguous_with": rivals, "gap": {"explained": 0.98}}
    facts["reason"] = "the refitted vehicle reaches the noise"
    assert gap_page.headline(facts) == title
    assert gap_page.headline({**facts, "gap": None})  # nothing could be driven


def test_logs_are_told_by_their_length_and_their_traps():
    log = {"seconds": 90.0, "warnings": ["a lag"]}
    assert log_page.headline({"logs": [log], "warnings": []}) == "90 s of driving in 1 log, 1 warning"
    two = {"logs": [{**log, "warnings": []}] * 2, "warnings": []}
    assert log_page.headline(two) == "3.0 min of driving in 2 logs, no warnings"
