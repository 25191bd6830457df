"""Two drivers side by side: Table I and the counterpart of the paper's Fig. 6, on one self-contained page.

A driver is a finished run that holds laps, a training run (its newest evaluation), or one of the paper's two laps.
"""

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from racerl.data.log import Log
from racerl.documents import conf_folder
from racerl.errors import ConfigError, RunError
from racerl.evaluate.laps import rows, score
from racerl.evaluate.outcome import track_table
from racerl.evaluate.recorded import follow
from racerl.paper import LAPS, PAPER, find_lap
from racerl.report.figures import duel
from racerl.report.flying_lap import FlyingLap, fastest_lap
from racerl.report.page import figure, write_page
from racerl.report.report import origins, paper_rows, table_row
from racerl.report.subjects import TRACK_COLUMNS, Evaluation, Subject, find_subjects
from racerl.run import RunFolder
from racerl.track.load import read_track

ALLOWED = f"finished evaluate, drive or train runs, {', '.join(LAPS)}"
CAPTION = (
    "The fastest lap of either, one that never leaves the track where there is one. Marks stand where the cars are at "
    "equal times since the line. Delta time is A's time at a place less B's: where it falls, A is gaining."
)
DIGITISED = (
    " The paper's laps are digitised; their speed and steering end 0.8 m before the line, the last value is held there."
)
SAME = 1e-3  # m, by which tables of one track may differ


@dataclass(frozen=True)
class Driver:
    """One side of the comparison."""

    subject: Subject
    lap: FlyingLap
    track: pd.DataFrame

    @classmethod
    def find(cls, word: str, outputs: Path, title: str = "{}") -> "Driver":
        """Return the driver that a word names, its title put into `title`; raise ConfigError or RunError."""
        subject = _of_paper(word) if word.startswith(PAPER) else _of_run(word, outputs)
        subject = replace(subject, title=title.format(subject.title))
        evaluation = subject.evaluation
        if evaluation is None:
            raise RunError(f"{word}: has not been raced; race it with: racerl evaluate {word}")
        lap = fastest_lap(subject.title, evaluation)
        if lap is None:
            raise RunError(f"{word}: finished no lap; race it for more laps=…, or train it for longer")
        return cls(subject, lap, evaluation.track)


def compare(settings: Mapping[str, Any], out: Path, outputs: Path = Path("outputs")) -> Path:
    """Write the figure and the page about the two of `settings["drivers"]`; return the page's path.

    Raises ConfigError or RunError, one line, for what cannot be compared.
    """
    words = [str(word) for word in _listed(settings["drivers"])]
    if len(words) != 2:
        raise ConfigError(f"drivers: {len(words)} given, two are compared ({ALLOWED}): racerl report compare A B")
    a, b = (Driver.find(word, outputs, f"{letter}: {{}}") for letter, word in zip("AB", words, strict=True))
    if not _same(a.track, b.track):
        raise RunError(f"{words[0]}, {words[1]}: were driven on different tracks; race both on one with track=…")
    theirs = bool(set(words) & set(LAPS))
    paper = [] if theirs else [Driver.find(word, outputs) for word in LAPS]
    paper = [driver for driver in paper if _same(driver.track, a.track)]
    folder = RunFolder.start(out, "compare", settings)
    svg = duel.draw(a.lap, b.lap, a.track, [driver.lap for driver in paper])
    caption = CAPTION + (DIGITISED if theirs or paper else "")
    page = write_page(
        folder.path,
        "compare_page.html.j2",
        headline=headline(a.lap, b.lap),
        words=words,
        rows=[table_row(a.subject), table_row(b.subject), *paper_rows()],
        figure=figure(
            folder.path / "compare.svg", "Lines, speed, delta time, steering, side slip and margin", caption, svg
        ),
        provenance=[row for driver in (a, b) for row in origins(driver.subject)],
    )
    folder.finish()
    return page


def headline(a: FlyingLap, b: FlyingLap) -> str:
    """Return whose fastest lap is faster, and by how much."""
    first, second = sorted((("A", a.time_s), ("B", b.time_s)), key=lambda lap: lap[1])
    if second[1] - first[1] < 0.0005:
        return f"A and B are equally fast: {first[1]:.3f} s"
    return f"{first[0]} is {second[1] - first[1]:.3f} s faster than {second[0]}: {first[1]:.3f} s to {second[1]:.3f} s"


def _listed(words: str | Sequence[Any]) -> Sequence[Any]:
    return [words] if isinstance(words, str) else words


def _of_run(word: str, outputs: Path) -> Subject:
    if not Path(word).is_dir():
        raise RunError(f"{word}: no such run; allowed are {ALLOWED}")
    found = find_subjects([Path(word)], outputs)
    if not found:
        raise RunError(f"{word}: is no run that holds laps; allowed are {ALLOWED}")
    return found[0]


def _of_paper(word: str) -> Subject:
    """Return one of the paper's laps, scored by our clock on the packaged track."""
    title, lap = find_lap(word)
    track = read_track(conf_folder() / "track" / "l_shape.csv")
    laps, drive = follow(track, [Log.from_table(word, lap)])
    metrics = {**score(laps), "track": track.name, "label": title, "car": "real", "rows": rows(laps, [0])}
    table = pd.read_csv(io.StringIO(track_table(track)))
    return Subject(word, title, None, None, Evaluation(Path(word), {}, metrics, drive, table))


def _same(track: pd.DataFrame, other: pd.DataFrame) -> bool:
    """Return whether two tables are of one track."""
    tables = [table[list(TRACK_COLUMNS)].to_numpy() for table in (track, other)]
    return len(track) == len(other) and bool(np.abs(tables[0] - tables[1]).max() < SAME)
