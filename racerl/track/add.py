"""A track by a name of its own: `conf/track/NAME.yaml` where racerl is run, and its centreline beside it."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from racerl.documents import conf_folder, read_text, write_text
from racerl.errors import DocumentError, TrackError, refused
from racerl.track.centreline import Centreline

OWN = Path("conf") / "track"
NAME = re.compile(r"[A-Za-z][A-Za-z0-9_-]{0,63}")
MEANT_OTHERWISE = {"file", "null", "true", "false", "inf", "nan", "add"}
KINDS = re.compile(r"[_-]?(map|centerline|centreline)$")


def usual_name(file: Path) -> str:
    """Return what a track of such a file may be called: `Oval_map.yaml` and `Oval_centerline.csv` are Oval."""
    stem = KINDS.sub("", file.stem) or file.resolve().parent.name
    return re.sub(r"[^A-Za-z0-9_-]+", "_", stem).strip("_")


def checked_name(name: Any) -> str:
    """Return a name that a track may have; raise TrackError for any other."""
    if not isinstance(name, str) or not NAME.fullmatch(name) or name.lower() in MEANT_OTHERWISE:
        raise TrackError(
            f"name = {name}: allowed is a letter, then up to 63 letters, digits, _ or -, and none of "
            f"{', '.join(sorted(MEANT_OTHERWISE))}; give another name=…"
        )
    return name


@dataclass(frozen=True)
class Entry:
    """What is written for a track of a name; made, it is known that nothing else stands there."""

    name: str
    centreline: Centreline
    about: str  # in one line

    def __post_init__(self) -> None:
        taken = [path for path, content in self.files() if path.exists() and not _holds(path, content)]
        packaged = conf_folder() / "track" / f"{self.name}.yaml"
        if not _packaged() and packaged.exists():
            taken.append(packaged)
        if taken:
            raise TrackError(f"name = {self.name}: there is a track of that name ({taken[0]}); give another name=…")

    def files(self) -> list[tuple[Path, str]]:
        """Return paths and contents: the centreline, and the YAML that names it."""
        table = OWN / f"{self.name}.csv"
        named = table.name if _packaged() else table.as_posix()
        return [(table, self.centreline.text()), (OWN / f"{self.name}.yaml", f"file: {named}  # {self.about}\n")]

    def write(self) -> list[Path]:
        """Write the files and return their paths; raise TrackError where the system refuses."""
        for path, content in self.files():
            try:
                write_text(path, content)
            except OSError as error:
                raise TrackError(f"name = {self.name}: {refused(error)}") from error
        return [path for path, _ in self.files()]


def _packaged() -> bool:
    """Return whether the conf/ here is the one that comes with racerl, whose tracks are found from anywhere."""
    return OWN.parent.resolve() == conf_folder().resolve()


def _holds(path: Path, content: str) -> bool:
    try:
        return read_text(path) == content
    except DocumentError:
        return False
