"""What a report is about: training runs with their newest evaluation, read from run folders."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from racerl.documents import as_frame, read_json
from racerl.errors import DocumentError, RunError
from racerl.evaluate.outcome import METRICS, TRACK, TRAJECTORIES
from racerl.optimum.floor import find_floor
from racerl.run import RunFolder, find_runs
from racerl.train.session import read_progress

DRIVE_COLUMNS = ("run", "seed", "lap", "t", "s", "n", "x", "y", "v_x")
TRACK_COLUMNS = ("s_m", "x_m", "y_m", "left_x_m", "left_y_m", "right_x_m", "right_y_m")
NUMBER, NUMBER_OR_NONE = (int, float), (int, float, type(None))
FIELDS: dict[str, tuple[type, ...]] = {
    "label": (str,),
    "car": (str,),
    "track": (str,),
    "rows": (list,),
    "laps": (int,),
    "valid_laps": (int,),
    "e_off": NUMBER,
    "crash_share": NUMBER,
    "fastest_valid_lap_s": NUMBER_OR_NONE,
    "mean_lap_s": NUMBER_OR_NONE,
    "settled_lap_s": NUMBER_OR_NONE,
    "std_lap_s": NUMBER_OR_NONE,
    "mean_lap_ci95": (list, type(None)),
}
ROW_FIELDS: dict[str, tuple[type, ...]] = {
    "seed": (int,),
    "number": (int,),
    "valid": (bool,),
    "time_s": NUMBER_OR_NONE,
}
MAX_ROWS = 20_000_000
RACED = ("evaluate", "drive")  # stages that leave laps


@dataclass(frozen=True)
class Evaluation:
    """One run of a stage that leaves laps."""

    path: Path
    manifest: dict[str, Any]
    metrics: dict[str, Any]
    drive: pd.DataFrame
    track: pd.DataFrame
    floor_s: float | None = None  # the time-optimal lap of the same car, track and limits, where it was found

    def fastest_row(self) -> dict[str, Any] | None:
        """Return what is noted of the fastest lap, a valid one if there is any; None when no lap was finished."""
        timed = [row for row in self.metrics["rows"] if row["time_s"] is not None]
        return min(timed, key=lambda row: (not row["valid"], row["time_s"]), default=None)

    def fastest_lap(self, beyond: int = 0) -> pd.DataFrame:
        """Return the samples of that lap; empty when no lap was finished.

        `beyond` adds that many rows of the same run before and after the lap.
        """
        best = self.fastest_row()
        if best is None:
            return self.drive.iloc[:0]
        rows = np.flatnonzero((self.drive["seed"] == best["seed"]) & (self.drive["lap"] == best["number"]))
        if not len(rows):
            return self.drive.iloc[:0]
        lap = self.drive.iloc[max(0, rows[0] - beyond) : rows[-1] + 1 + beyond]
        return lap[lap["run"] == self.drive["run"].iloc[rows[0]]]


@dataclass(frozen=True)
class Subject:
    """A policy: how it was trained and how it raced; either may be missing."""

    name: str
    title: str  # what the policy is; with the name where several are the same
    training: dict[str, Any] | None  # the manifest
    progress: pd.DataFrame | None
    evaluation: Evaluation | None


def find_subjects(paths: list[Path], outputs: Path) -> list[Subject]:
    """Return the subjects of the runs given, or of all complete runs under `outputs`.

    A training run comes with its newest evaluation under `outputs`, unless evaluations of it are given.
    """
    given = [RunFolder.open_complete(path) for path in paths]
    around = find_runs(outputs)
    trained = {run.manifest["run_id"]: run for run in (*around, *given) if run.manifest["stage"] == "train"}
    by_finish = sorted(around, key=lambda run: str(run.manifest.get("finished")))
    newest = {_origin(run): run for run in by_finish if run.manifest["stage"] in RACED}
    chosen = [run for run in given if run.manifest["stage"] in RACED] if given else list(newest.values())
    raced = {_origin(run) for run in chosen}
    pairs: list[tuple[RunFolder | None, RunFolder | None]] = [(trained.get(_origin(run)), run) for run in chosen]
    pairs += [
        (run, newest.get(run.manifest["run_id"]))
        for run in given or around
        if run.manifest["stage"] == "train" and run.manifest["run_id"] not in raced
    ]
    pairs.sort(key=lambda pair: str(next(run for run in pair if run).manifest.get("started")))
    return _with_own_titles([_subject(*pair, around) for pair in pairs])


def _origin(evaluation: RunFolder) -> str:
    """Return the id of the training run that an evaluation raced; its own where there was none."""
    return str(evaluation.manifest.get("train_run_id") or evaluation.manifest["run_id"])


def _with_own_titles(subjects: list[Subject]) -> list[Subject]:
    """Return the subjects with their names added to titles that occur more than once."""
    count = Counter(subject.title for subject in subjects)
    return [replace(s, title=f"{s.name}: {s.title}") if count[s.title] > 1 else s for s in subjects]


def _subject(training: RunFolder | None, evaluated: RunFolder | None, around: Sequence[RunFolder]) -> Subject:
    evaluation = _read_evaluation(evaluated) if evaluated else None
    if evaluation:
        known = evaluation.metrics.get("optimum_s")
        floor = known if isinstance(known, float) else find_floor(evaluation.manifest.get("problem"), around)
        evaluation = replace(evaluation, floor_s=floor)
    progress = read_progress(training.path) if training else None
    name = next(run for run in (training, evaluated) if run).path.name
    title = str(evaluation.metrics["label"]) if evaluation else name
    return Subject(name, title, training.manifest if training else None, progress, evaluation)


def _read_evaluation(folder: RunFolder) -> Evaluation:
    try:
        metrics = read_json(folder.path / METRICS)
        metrics.setdefault("settled_lap_s", None)  # of runs before it was measured
        _check(metrics, FIELDS, METRICS)
        for row in metrics["rows"]:
            _check(row, ROW_FIELDS, f"{METRICS}, rows")
        drive = _finite_table(_read_drive(folder.path / TRAJECTORIES), DRIVE_COLUMNS, TRAJECTORIES)
        if "delta" not in drive:
            raise ValueError(f"{TRAJECTORIES}: delta missing")
        drive["delta"] = pd.to_numeric(drive["delta"])  # NaN in the log of a car that did not measure it
        track = _finite_table(pd.read_csv(folder.path / TRACK), TRACK_COLUMNS, TRACK)
    except (DocumentError, OSError, ValueError, pa.ArrowException) as error:
        raise RunError(f"{folder.path}: is damaged ({' '.join(str(error).split())}); evaluate again") from error
    return Evaluation(folder.path, folder.manifest, metrics, drive, track)


def _read_drive(path: Path) -> pd.DataFrame:
    rows = pq.read_metadata(path).num_rows
    if rows > MAX_ROWS:
        raise ValueError(f"{path.name} holds {rows} rows, at most {MAX_ROWS} are read")
    return as_frame(pq.read_table(path, use_threads=False))


def _check(record: Any, fields: Mapping[str, tuple[type, ...]], where: str) -> None:
    """Raise ValueError when a field is missing or of another type."""
    if not isinstance(record, dict):
        raise ValueError(f"{where}: {record!r} is no record")
    for name, kinds in fields.items():
        if name not in record or not isinstance(record[name], kinds):
            raise ValueError(f"{where}: {name} is {record.get(name, 'missing')!r}")


def _finite_table(table: pd.DataFrame, columns: Sequence[str], where: str) -> pd.DataFrame:
    """Return the table; raise ValueError when a column is missing or not finite numbers."""
    missing = [name for name in columns if name not in table]
    if missing or not len(table):
        raise ValueError(f"{where}: {', '.join(missing) or 'every row'} missing")
    if not np.isfinite(table[list(columns)].apply(pd.to_numeric).to_numpy(dtype=float)).all():
        raise ValueError(f"{where}: holds NaN")
    return table
