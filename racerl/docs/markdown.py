"""The little of Markdown that the site and the tests read: code blocks, transcripts, links, anchors."""

import re
import shlex
from collections.abc import Iterator
from typing import NamedTuple

BLOCK = re.compile(r"^```(\w*)\n(.*?)^```", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\(([^)\s]+)\)")
SPECIAL = re.compile(r"([\\`*_\[\]<>|])")
PROGRAM = "racerl"


class Transcript(NamedTuple):
    """A command as typed, and what it said."""

    command: str
    output: str

    @property
    def words(self) -> list[str]:
        """The words behind `racerl`."""
        return shlex.split(self.command, comments=True)[1:]


def blocks(text: str, *kinds: str) -> list[str]:
    """Return the code blocks of these kinds."""
    return [code for kind, code in BLOCK.findall(text) if kind in kinds]


def transcripts(text: str) -> list[Transcript]:
    """Return what is typed at the prompts of a page's console blocks, and what is answered."""
    typed = (part for block in blocks(text, "console") for part in re.split(r"^\$ ", block, flags=re.MULTILINE)[1:])
    return [Transcript(command, output.strip("\n")) for command, _, output in (part.partition("\n") for part in typed)]


def commands(text: str) -> Iterator[str]:
    """Yield the lines by which a page calls racerl: at its prompts, and in its shell blocks, where && joins several."""
    yield from (each.command for each in transcripts(text) if each.command.startswith(f"{PROGRAM} "))
    for line in "".join(blocks(text, "sh")).splitlines():
        yield from (part for part in line.split(" && ") if part.startswith(f"{PROGRAM} "))


def links(text: str) -> list[str]:
    """Return where a page's links and pictures lead, but for those out of the repository."""
    return [target for target in LINK.findall(BLOCK.sub("", text)) if "://" not in target]


def headings(text: str) -> list[str]:
    """Return a page's headings."""
    return re.findall(r"^#+ (.+)$", BLOCK.sub("", text), re.MULTILINE)


def anchor(heading: str, separator: str = "-") -> str:
    """Return a heading's anchor, as GitHub makes it."""
    return re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", separator)


def literal(text: str) -> str:
    """Return a text that shows as it stands."""
    return SPECIAL.sub(r"\\\1", text)


def fenced(kind: str, code: str) -> str:
    """Return a code block."""
    return f"```{kind}\n{code.strip(chr(10))}\n```"
