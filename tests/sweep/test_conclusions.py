"""Terminal and page say of a sweep what its results.json holds."""

from racerl.sweep.conclusions import banner, grouped, headline, lines


def facts(*verdicts, trial_steps=None):
    claims = [
        {"claim": number, "says": "so", "verdict": verdict, "why": why}
        for number, (verdict, why) in enumerate(verdicts, 1)
    ]
    return {"claims": claims, "trial_steps": trial_steps, "jobs": {"planned": 2, "done": 2}}


def test_the_headline_counts_every_verdict():
    found = facts(("refuted", ""), ("undecided", "1 training"), ("not tested", "mpc has not been driven"))
    assert headline(found) == "0 supported, 1 refuted, 1 undecided, 1 not tested" and not banner(found)
    assert lines(found)[2:] == [
        "claim 2: undecided, 1 training: so",
        "claim 3: not tested, mpc has not been driven: so",
    ]


def test_a_trial_has_a_banner_and_no_verdicts():
    found = facts((None, "trial budget"), trial_steps=2048)
    assert lines(found)[0].startswith("Trial budget: trainings of 2,048 control steps")
    assert headline(found) == "A trial of 2,048 control steps per training: no verdicts"
    assert lines(found)[2] == "claim 1: no verdict, trial budget: so"
    assert not any(word in " ".join(lines(found)) for word in ("supported", "refuted", "undecided"))


def test_a_claim_about_what_is_not_trained_counts_for_every_policy_and_numbers_may_repeat():
    claims = [
        {"claim": 1, "says": "so", "sweep": "a", "policy": "learned", "verdict": "supported", "why": ""},
        {"claim": 1, "says": "so", "sweep": "a", "policy": "refined", "verdict": "refuted", "why": ""},
        {"claim": 1, "says": "thus", "sweep": "b", "policy": "", "verdict": "undecided", "why": "1 training"},
    ]
    found = {"claims": claims, "trial_steps": None, "jobs": {"planned": 2, "done": 2}}
    assert headline(found) == (
        "As learned: 1 supported, 0 refuted, 1 undecided, 0 not tested; "
        "refined: 0 supported, 1 refuted, 1 undecided, 0 not tested"
    )
    assert lines(found)[1:] == [
        "claim 1: as learned supported; refined refuted: so",
        "claim 1: undecided, 1 training: thus",
    ]
    assert [len(same) for same in grouped(claims)] == [2, 1]
