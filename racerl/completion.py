"""What the shell offers behind <TAB>: groups and choices, sweeps, controllers, benchmarks, effects, second words.

Bash breaks words at `=` and `:`, and puts an answer in place of the last piece. So its pieces are joined before
anything looks at them, and of an answer only what lies behind the last break is printed. `bud` is answered by
`budget=laptop` and its like, of which the shell takes what they share: no blank lands behind the `=`.
"""

import contextlib
import io
import os
import shlex
from collections.abc import Callable, Iterator

from racerl.choices import choices, default_groups

TWO_WORDS = ("gap plan", "gap close", "report compare", "track add")  # commands
BREAKS = "=:"  # of Bash's COMP_WORDBREAKS, those that racerl's words hold
BASH = "_RACERL_COMPLETE", "complete_bash"  # what the shell's hook sets


def overrides(*commands: str, others: Callable[[], list[str]] = list) -> Callable[[str], list[str]]:
    """Return what completes words for commands: group=choice, and other words that they may begin with."""

    def complete(incomplete: str) -> list[str]:
        plus = "+" if incomplete.startswith("+") else ""
        word = incomplete.lstrip("+")
        groups = dict.fromkeys(group for command in commands for group in _groups(command))
        offered = [f"{group}={choice}" for group in groups for choice in choices(group)]
        found = [f"{plus}{each}" for each in offered if each.startswith(word)]
        return found + ([each for each in others() if each.startswith(word)] if not plus and "=" not in word else [])

    return complete


def _groups(command: str) -> list[str]:
    """Return a command's groups, and those inside them that add something."""
    groups = default_groups(command)
    return [*groups, *(["vehicle/effect"] if "vehicle" in groups else [])]


def sweeps() -> list[str]:
    """Return the names of all sweeps."""
    from racerl.sweep.definition import names

    return names()


def effects(incomplete: str) -> list[str]:
    """Complete the name of an effect."""
    return [name for name in choices("vehicle/effect") if name.startswith(incomplete)]


def as_commands(words: list[str]) -> list[str]:
    """Return a command line whose command is one word, perhaps with a blank in it."""
    two = " ".join(words[:2])
    return [two, *words[2:]] if two in TWO_WORDS else words


def joined(pieces: list[str]) -> tuple[list[str], int]:
    """Return Bash's pieces put together to words, and how much of the last one is fixed."""
    words: list[str] = []
    glued, fixed = False, 0
    for piece in pieces:
        breaks = bool(piece) and all(letter in BREAKS for letter in piece)
        if words and (breaks or glued):
            fixed = len(words[-1]) + (len(piece) if breaks else 0)
            words[-1] += piece
        else:
            words.append(piece)
            fixed = 0
        glued = breaks
    return words, fixed


@contextlib.contextmanager
def for_bash() -> Iterator[None]:
    """Mend what Bash breaks, where it is the one that asks."""
    variable, asked = BASH
    if os.environ.get(variable) != asked:
        yield
        return
    pieces = os.environ.get("COMP_WORDS", "").split("\n")
    words, fixed = joined(pieces[: int(os.environ.get("COMP_CWORD", "0")) + 1])
    if len(words) > 3:  # racerl, two words of a command, and one to complete
        words = [words[0], *as_commands(words[1:])]
    os.environ["COMP_WORDS"], os.environ["COMP_CWORD"] = "\n".join(map(shlex.quote, words)), str(len(words) - 1)
    printed = io.StringIO()
    try:
        with contextlib.redirect_stdout(printed):
            yield
    finally:
        print("\n".join(line[fixed:] for line in printed.getvalue().splitlines()))
