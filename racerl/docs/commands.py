"""A page per command: its help, its settings, and what it says where a README shows it."""

import inspect
from collections.abc import Iterator
from typing import Any

import typer

from racerl.cli import app
from racerl.completion import as_commands
from racerl.config import composed, spoken
from racerl.docs.markdown import Transcript, fenced, headings, literal, transcripts
from racerl.docs.sources import readmes
from racerl.documents import conf_folder


def pages() -> dict[str, str]:
    """Return the page of each command and the list of all, by their places."""
    known = _commands()
    return {"commands/index.md": _index(known)} | {_place(name): _page(name, each) for name, each in known.items()}


def _commands() -> dict[str, Any]:
    """Return all commands by the words that call them, those of two words behind their first."""
    group: Any = typer.main.get_command(app)  # Click's, or Typer's own copy of it
    names = sorted(group.commands, key=lambda name: (list(group.commands).index(name.split()[0]), name))
    return {name: group.commands[name] for name in names}


def _place(name: str) -> str:
    return f"commands/{name.replace(' ', '_')}.md"


def _index(known: dict[str, Any]) -> str:
    rows = [f"| [racerl {name}]({name.replace(' ', '_')}.md) | {_help(each)[0]} |" for name, each in known.items()]
    return "\n".join(["# The commands\n", "| command | what it does |\n| --- | --- |", *rows])


def _help(command: Any) -> list[str]:
    """Return the paragraphs of a command's help, each in one line."""
    return [literal(" ".join(part.split())) for part in inspect.cleandoc(command.help or "").split("\n\n")]


def _page(name: str, command: Any) -> str:
    words = " ".join(parameter.metavar or "" for parameter in command.params if parameter.param_type_name == "argument")
    usage = fenced("console", f"$ racerl {name} {words}")
    return "\n\n".join([f"# racerl {name}", *_help(command), usage, *_settings(name), *_shown(name)])


def _settings(name: str) -> Iterator[str]:
    """Yield the settings of every configuration that the command runs with."""
    for file in sorted(conf_folder().glob("*.yaml"), key=lambda file: (file.stem != name, file.stem)):
        if spoken(file.stem) == f"racerl {name}":
            first = file.read_text(encoding="utf-8").partition("\n")[0].removeprefix("# ")
            yield f"## Settings\n\n`{first}`" if file.stem == name else f"## Settings: `{first}`"
            yield fenced("yaml", composed(file.stem))


def _shown(name: str) -> Iterator[str]:
    """Yield what the command says, where a README shows it."""
    for place, file in readmes().items():
        text = file.read_text(encoding="utf-8")
        seen = [each for each in transcripts(text) if _calls(each, name) and each.output]
        if seen:
            yield f"## In [{headings(text)[0]}](../{place})"
            yield fenced("console", "\n".join(f"$ {each.command}\n{each.output}" for each in seen))


def _calls(transcript: Transcript, name: str) -> bool:
    return as_commands(transcript.words)[0] == name
