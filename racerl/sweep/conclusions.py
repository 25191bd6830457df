"""What a sweep's results come to in words, the same on the terminal and on its page."""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from racerl.sweep.jobs import LEARNED, REFINED, policies
from racerl.sweep.statistics import VERDICTS, told

POLICIES = {"": "", LEARNED: "as learned", REFINED: "refined"}  # in words


def headline(facts: Mapping[str, Any]) -> str:
    """Return results.json in one line."""
    claims = facts["claims"]
    if steps := facts["trial_steps"]:
        return f"A trial of {steps:,} control steps per training: no verdicts"
    if not claims:
        return f"{facts['jobs']['done']} of {facts['jobs']['planned']} jobs done, no claims to weigh"
    found = {}
    for policy in policies(map(of, claims)):
        # what is not trained has one verdict, which counts for all
        counts = Counter(claim["verdict"] for claim in claims if of(claim) in (policy, ""))
        found[policy] = ", ".join(f"{counts[verdict]} {verdict}" for verdict in VERDICTS)
    if len(found) == 1:
        return next(iter(found.values()))
    said = "; ".join(f"{POLICIES[policy]}: {counted}" for policy, counted in found.items())
    return said[0].upper() + said[1:]


def of(row: Mapping[str, Any]) -> str:
    """Return the policy that an arm's row or a claim is about; empty for what is not trained."""
    return str(row.get("policy", ""))


def grouped(claims: Sequence[Mapping[str, Any]]) -> list[list[Mapping[str, Any]]]:
    """Return claims with their verdicts for every policy together."""
    found: dict[tuple[str, int], list[Mapping[str, Any]]] = {}
    for claim in claims:
        found.setdefault((claim.get("sweep", ""), claim["claim"]), []).append(claim)
    return list(found.values())


def verdict(claims: Sequence[Mapping[str, Any]]) -> str:
    """Return what came of a claim, once where it is the same for every policy."""
    said = {of(claim): told(claim) for claim in claims}
    if len(set(said.values())) == 1:
        return told(claims[0])
    return "; ".join(f"{POLICIES[policy]} {words}" for policy, words in said.items())


def banner(facts: Mapping[str, Any]) -> str:
    """Return the warning that belongs above the results of a trial; empty otherwise."""
    if not facts["trial_steps"]:
        return ""
    return (
        f"Trial budget: trainings of {facts['trial_steps']:,} control steps show that a sweep runs, not what is true. "
        "For verdicts leave budget=smoke out"
    )


def lines(facts: Mapping[str, Any]) -> list[str]:
    """Return what the terminal says of the results: banner, headline and a line per claim."""
    claims = [f"claim {same[0]['claim']}: {verdict(same)}: {same[0]['says']}" for same in grouped(facts["claims"])]
    return [*filter(None, (banner(facts),)), headline(facts), *claims]
