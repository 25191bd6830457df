"""A verdict in plain words: what the terminal and the page begin with, from the facts of verdict.json alone."""

from collections.abc import Mapping, Sequence
from typing import Any

from racerl.vehicle import catalogue

PLAIN = {"steering": "steering", "drive": "drive", "chassis": "motion"}  # stages, as they are told
HALF, LITTLE = 0.5, 2.0  # of the gap, which a name should explain; times the noise, up to which little is left
NOTHING = {
    "under_excited": "This log cannot tell what is missing",
    "unknown": "Something real is missing that no known effect explains",
}


def headline(facts: Mapping[str, Any]) -> str:
    """Return a verdict in one sentence, without its effects' numbers."""
    names, rivals = [effect["name"] for effect in facts["effects"]], facts["ambiguous_with"]
    said = [f"{row['what']}: {_change(row)} than configured" for row in facts["configured"]["changes"]]
    if names:
        said.append(listed([in_words(name) for name in names], ", and "))
    elif facts["verdict"] in NOTHING:
        said.append(NOTHING[facts["verdict"]])
    elif not said:
        said.append(f"nothing is missing: {facts['reason']}")
    if rivals:
        said.append(f"or {listed([in_words(name) for name in rivals], ', or ')}")
    return _capital("; ".join(said))


def opening(facts: Mapping[str, Any]) -> list[str]:
    """Return a verdict in sentences: the numbers that are off, what the car does, and what that is worth."""
    lines = numbers_told(facts["configured"])
    lines += [_effect(effect) for effect in facts["effects"]]
    if rivals := facts["ambiguous_with"]:
        rather = listed([f"{in_words(name)} ({name.replace('_', ' ')})" for name in rivals], ", or ")
        lines.append(f"this log cannot distinguish that from: {rather}")
    if not facts["effects"] and (facts["verdict"] in NOTHING or not lines):
        lines.append(NOTHING.get(facts["verdict"], f"nothing is missing: {facts['reason']}"))
    gap = facts["gap"]
    if gap and facts["effects"]:
        before, after = f"{gap['before']:.2f}", f"{gap['after']:.2f}"
        moves = f"falls from {before}" if gap["after"] < gap["before"] else f"goes from {before}"
        lines.append(f"with that the error {moves} to {after} times the sensors' noise")
        if gap["explained"] < HALF and gap["after"] > LITTLE:
            standing = "these effects may be standing in for it"
            lines.append(f"most of the gap remains unexplained: something else is missing too, and {standing}")
    return [f"{_capital(line)}." for line in lines]


def numbers_told(configured: Mapping[str, Any]) -> list[str]:
    """Return a line for every number that was configured wrongly, and one for a refit of all that explains more."""
    lines = [
        f"{row['what']}: {_change(row)} than configured, {row['parameter']} {row['to']:.4g} "
        f"({row['ci95'][0]:.4g} … {row['ci95'][1]:.4g}) instead of {row['from']:.4g}; this explains "
        f"{row['explained']:.0%} of the error of the vehicle as configured, "
        f"in the {' and the '.join(PLAIN[stage] for stage in row['stages'])}"
        for row in configured["changes"]
    ]
    if lines and configured["rest"]:
        more = f"refitting all parameters around that explains another {configured['rest']:.0%}"
        lines.append(f"{more}; model.yaml holds this refit")
    return lines


def in_short(hypothesis: Mapping[str, Any]) -> str:
    """Return what a hypothesis says is hidden."""
    known = [name.replace("_", " ") for name in hypothesis["names"] if name != "?"]
    return listed([*known, *(["something not in the catalogue"] if "?" in hypothesis["names"] else [])]) or "nothing"


def likely(facts: Mapping[str, Any]) -> str:
    """Return the most probable hypotheses with their probabilities."""
    rows = [row for row in facts["hypotheses"][:3] if row["probability"] >= 0.01]
    return "; ".join(f"{in_short(row)} {row['probability']:.0%}" for row in rows)


def unseen(facts: Mapping[str, Any]) -> str:
    """Return which effects a log would not show, or how many where those are not told at a glance."""
    blind = facts["blind_to"]
    what = f"{len(blind)} effects (the report has them)" if len(blind) > 6 else listed(blind)
    return f"would not show in this log at their usual size: {what}" if blind else ""


def why_not(facts: Mapping[str, Any], hypothesis: Mapping[str, Any]) -> str:
    """Return why a hypothesis is not the first: what it lacks, or what the first does without more."""
    names, first = set(hypothesis["names"]), set(facts["hypotheses"][0]["names"])
    found = {effect["name"] for effect in facts["effects"] or facts["helped"]}
    errors = {key: f"{facts['gap'][key]:.2f} times the sensors' noise" for key in ("before", "after") if facts["gap"]}
    if names == first:
        return ""
    if not names and errors:
        return f"refitted without any effect the error stays at {errors['before']}"
    if first and first < names and first == found and errors:
        return f"without more the error is at {errors['after']}"
    if names == first - {"?"} == found and errors:
        return f"with that alone the error stays at {errors['after']}"
    return _behind(facts["ranking"], *names) if len(names) == 1 else ""


def _behind(ranking: Sequence[Mapping[str, Any]], name: str) -> str:
    """Return by how much an effect is behind the best candidate; nothing of what was not ranked behind it."""
    row = next((row for row in ranking[1:] if row["name"] == name), None)
    if row is None:
        return ""
    best = f"{ranking[0]['name'].replace('_', ' ')} {ranking[0]['explained']:.0%}"
    explained = f"explains {row['explained']:.0%} of the excess, {best}"
    return f"{explained}; {row['behind']:.1f} standard errors behind on held-out windows"


def in_words(effect: str) -> str:
    """Return what a car with an effect does, as a clause; the first line of its docstring where that is not told."""
    entry = catalogue.entry(effect)
    return entry.aspects.get("In words", entry.title).rstrip(".")


def _effect(effect: Mapping[str, Any]) -> str:
    """Return an effect with its values: "your car resists turning: yaw damping 0.40 N m s (0.36 … 0.44)"."""
    parameters, name = effect["parameters"], effect["name"].replace("_", " ")
    alone = len(parameters) == 1
    values = [_value(p) if alone else f"{key.replace('_', ' ')} {_value(p)}" for key, p in parameters.items()]
    return f"{in_words(effect['name'])}: {name} {', '.join(values)}"


def _value(p: Mapping[str, Any]) -> str:
    unit = f" {p['unit']}" if p["unit"] else ""
    return f"{p['value']:.4g}{unit} ({p['ci95'][0]:.4g} … {p['ci95'][1]:.4g})"


def _change(row: Mapping[str, Any]) -> str:
    return f"{abs(row['to'] / row['from'] - 1.0):.0%} {'less' if row['to'] < row['from'] else 'more'}"


def listed(parts: Sequence[str], last: str = " and ") -> str:
    """Return parts as they stand in a sentence: a, b and c; `last` stands before the last one."""
    return last.join([*([", ".join(parts[:-1])] if len(parts) > 1 else []), *parts[-1:]])


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]
