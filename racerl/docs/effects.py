"""A page per effect: its docstring, its parameters, its configuration, and what came of it in the blind tests."""

import re
from collections.abc import Iterator
from functools import cache
from typing import Any

from racerl.docs.markdown import fenced, literal
from racerl.docs.sources import ROOT
from racerl.documents import conf_folder, read_json
from racerl.vehicle import catalogue

BLIND = "outputs/reference/gap"  # the figures of the blind tests
LABELS = {"verdict": "Verdict", "found": "Named", "programme": "Driven", "sizes": "Size", "noise": "Noise"}


def pages() -> dict[str, str]:
    """Return the page of each effect and the list of all, by their places."""
    return {"effects/index.md": _index()} | {f"effects/{name}.md": _page(name) for name in _names()}


def _index() -> str:
    entries = [catalogue.entry(name) for name in _names()]
    rows = [f"| [{e.name}]({e.name}.md) | {literal(e.title)} | {literal(e.aspects['In words'])} |" for e in entries]
    return "\n".join(
        [
            f"# The {len(rows)} effects\n",
            "What a car may do and its model does not.",
            "`racerl gap` names them from a log, `+vehicle/effect=NAME` adds one.\n",
            "| effect | what it is | in words |\n| --- | --- | --- |",
            *rows,
        ]
    )


def _page(name: str) -> str:
    entry = catalogue.entry(name)
    aspects = [f"**{label}:** {_aspect(label, text)}" for label, text in entry.aspects.items()]
    rows = [
        f"| `{parameter}` | {literal(known.meaning)} | {known.low:g} … {known.high:g} {literal(known.unit)} |"
        for parameter, known in entry.parameters.items()
    ]
    shipped = (conf_folder() / "vehicle" / "effect" / f"{name}.yaml").read_text(encoding="utf-8")
    parts = [
        f"# {name}",
        literal(entry.title),
        *aspects,
        "\n".join(["## Parameters\n", "| parameter | meaning | range |\n| --- | --- | --- |", *rows]),
        f"`+vehicle/effect={name}` adds it to any car with",
        fenced("yaml", shipped),
        f"and `vehicle.effects.{name}.{next(iter(entry.parameters))}=…` changes that.",
        *_blind(name),
    ]
    return "\n\n".join(parts)


def _aspect(label: str, text: str) -> str:
    """Return an aspect with the effects that it names linked."""
    if label == "Formula":
        return f"`{text}`"
    words = re.split(r"([a-z_]+)", text)
    return "".join(f"[{word}]({word}.md)" if word in _names() else literal(word) for word in words)


@cache
def _names() -> list[str]:
    return catalogue.names()


def _blind(name: str) -> Iterator[str]:
    """Yield what `racerl gap` said of simulated logs in which this effect alone was hidden."""
    alone = [(file, sha, case) for file, sha, case in _cases() if case["truth"] == [name]]
    if alone:
        yield "## In the blind tests"
        yield f"[Simulated cars](../{BLIND}/README.md) in which it alone was hidden, and what `racerl gap` said of it."
        head = ["Test", "Code", *LABELS.values()]
        rows = [[f"[{file[:-5]}](../{BLIND}/{file})", f"`{sha[:7]}`", *_cells(case)] for file, sha, case in alone]
        yield "\n".join(f"| {' | '.join(row)} |" for row in [head, ["---"] * len(head), *rows])


def _cells(case: dict[str, Any]) -> Iterator[str]:
    for key in LABELS:
        value = case.get(key, "")
        yield literal(", ".join(value) if isinstance(value, list) else str(value)) or "–"


@cache
def _cases() -> list[tuple[str, str, dict[str, Any]]]:
    """Return the cases of all blind tests, each behind its file and the code that was tested."""
    tests = {file.name: read_json(file) for file in sorted((ROOT / BLIND).glob("bench*.json"))}
    return [(name, test["git_sha"], case) for name, test in tests.items() for case in test["gap"]["cases"]]
