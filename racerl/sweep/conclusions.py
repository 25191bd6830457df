"""What a sweep's results come to in words, the same on the terminal and on its page."""

from collections import Counter
from collections.abc import Mapping
from typing import Any

from racerl.sweep.statistics import VERDICTS, told


def headline(facts: Mapping[str, Any]) -> str:
    """Return results.json in one line."""
    if steps := facts["trial_steps"]:
        return f"A trial of {steps:,} control steps per training: no verdicts"
    if not facts["claims"]:
        return f"{facts['jobs']['done']} of {facts['jobs']['planned']} jobs done, no claims to weigh"
    counts = Counter(claim["verdict"] for claim in facts["claims"])
    return ", ".join(f"{counts[verdict]} {verdict}" for verdict in VERDICTS)


def banner(facts: Mapping[str, Any]) -> str:
    """Return the warning that belongs above the results of a trial; empty otherwise."""
    if not facts["trial_steps"]:
        return ""
    return (
        f"Trial budget: trainings of {facts['trial_steps']:,} control steps show that a sweep runs, not what is true. "
        "For verdicts: budget=laptop"
    )


def lines(facts: Mapping[str, Any]) -> list[str]:
    """Return what the terminal says of the results: banner, headline and a line per claim."""
    claims = [f"claim {claim['claim']}: {told(claim)}: {claim['says']}" for claim in facts["claims"]]
    return [*filter(None, (banner(facts),)), headline(facts), *claims]
