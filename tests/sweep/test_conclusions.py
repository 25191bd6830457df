"""Terminal and page say of a sweep what its results.json holds."""

from racerl.sweep.conclusions import banner, headline, lines


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
