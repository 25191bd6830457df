"""Who drove a lap: a finished run with laps, a training run (its newest evaluation), or one of the paper's two."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from racerl import bounds
from racerl.data.log import Log
from racerl.documents import conf_folder
from racerl.errors import RunError
from racerl.evaluate.laps import rows, score
from racerl.evaluate.outcome import track_table
from racerl.evaluate.recorded import follow
from racerl.paper import LAPS, PAPER, find_lap
from racerl.report.flying_lap import FlyingLap, fastest_lap
from racerl.report.subjects import TRACK_COLUMNS, Evaluation, Subject, find_subjects
from racerl.track.load import read_track

ALLOWED = f"finished evaluate, drive or train runs, {', '.join(LAPS)}"
SAME = 1e-3  # m, by which tables of one track may differ


@dataclass(frozen=True)
class Driver:
    """A driver with the fastest lap and its track."""

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


def listed(words: Any) -> list[str]:
    """Return the drivers of a setting, which may be one or a list; raise ConfigError for anything else."""
    return bounds.words("drivers", words, f"a list is expected; allowed are {ALLOWED}")


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
    table = track_table(track)
    return Subject(word, title, None, None, Evaluation(Path(word), {}, metrics, drive, table))


def same(track: pd.DataFrame, other: pd.DataFrame) -> bool:
    """Return whether two tables are of one track."""
    tables = [table[list(TRACK_COLUMNS)].to_numpy() for table in (track, other)]
    return len(track) == len(other) and bool(np.abs(tables[0] - tables[1]).max() < SAME)
