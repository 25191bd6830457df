"""The tour is driven as it is written: what its commands say is what it shows."""

import pytest

from racerl.docs.markdown import transcripts
from racerl.docs.sources import ROOT

TOUR = transcripts((ROOT / "racerl" / "docs" / "tour" / "README.md").read_text(encoding="utf-8"))
STAGES = ["record", "data", "identify", "gap", "train", "evaluate"]
QUICK = ["budget.ascent.updates=1", "budget.ascent.evaluations=1"]


def quick(words):
    """Return a training's words for seconds; others as they are."""
    if words[0] != "train":
        return words
    fewer = QUICK if any(word.startswith("from=") for word in words) else ["budget=smoke"]
    return [*(word for word in words if word != "algo=imitation"), *fewer]


def test_it_goes_all_the_way():
    assert list(dict.fromkeys(each.words[0] for each in TOUR)) == STAGES


@pytest.mark.slow
def test_it_says_what_it_shows(run):
    """Of trainings it shows no lap, so seconds of them will do; the policy from before is the README's first."""
    assert run("train", "budget=smoke", "+dr=friction_0.02", "out=outputs/train/first").returncode == 0
    for transcript in TOUR:
        done = run(*quick(transcript.words))
        assert done.returncode == 0, f"{transcript.command}: {done.stderr}"
        said = " ".join(done.stdout.split())
        assert [line for line in transcript.output.splitlines() if " ".join(line.split()) not in said] == []
