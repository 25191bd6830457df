"""Jobs that another sweep has finished, on another machine or another day: their rows stand in for those of this one.

A job's name ends with a hash of all its settings, so only what was trained with the very same ones counts. Its laps
must have been raced from the same starts, as far, and in all cars that are asked for.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from racerl.errors import ConfigError, RunError
from racerl.run import RunFolder
from racerl.sweep.jobs import Plan

LAPS, LEARNING, TRAININGS, STEERING = "laps.csv", "learning.csv", "trainings.csv", "steering.csv"
KEY = ["sweep", "arm", "seed"]
SAME = ("laps", "starts")  # settings that laps are comparable by
ORIGIN = ("git_sha", "cpu", "threads")  # of the other sweep

Key = tuple[str, str, int]  # sweep, arm, seed
Tables = Mapping[str, pd.DataFrame]  # by file


@dataclass(frozen=True)
class Elsewhere:
    """What other sweeps finished of a plan: its tables by sweep, arm and seed, and where they came from."""

    tables: Mapping[Key, Tables]
    origins: Sequence[Mapping[str, Any]]

    @classmethod
    def read(cls, folders: Iterable[str], planned: Plan, settings: Mapping[str, Any]) -> "Elsewhere":
        """Read the folders of other sweeps; raise ConfigError or RunError for those that are of no use here."""
        tables: dict[Key, Tables] = {}
        origins = []
        for name in folders:
            run = RunFolder.open(Path(name), "sweep")
            _require_alike(name, run.settings(), settings)
            found = _tables(run.path, planned, {key: job.path.name for key, job in planned.of.items()})
            if not found:
                raise ConfigError(
                    f"also = {name}: none of its trainings is one of this sweep's, their settings differ; "
                    "give both the same words and threads="
                )
            jobs = {planned.of[key].path.name for key in found.keys() - tables.keys()}
            origins.append({"jobs": len(jobs), **{key: run.manifest.get(key) for key in ORIGIN}})
            tables = {**found, **tables}
        return cls(tables, origins)

    def has(self, planned: Plan) -> set[str]:
        """Return the names of the jobs whose every arm is here, so that they need not run."""
        missing = {planned.of[key].name for key in planned.of.keys() - self.tables.keys()}
        return {job.name for job in planned.jobs} - missing


NOTHING = Elsewhere({}, ())


def _require_alike(name: str, theirs: Mapping[str, Any], ours: Mapping[str, Any]) -> None:
    for key in SAME:
        if theirs.get(key) != ours[key]:
            raise ConfigError(f"also = {name}: has {key} = {theirs.get(key)}, this sweep {ours[key]}; make them equal")
    raced = [*theirs.get("cars", ()), *theirs.get("twins", ())]
    for car in (*ours["cars"], *ours["twins"]):
        if car not in raced:
            raise ConfigError(f"also = {name}: did not race in {car}; leave it out (cars=, twins=) or race it there")


def _tables(folder: Path, planned: Plan, jobs: Mapping[Key, str]) -> dict[Key, Tables]:
    """Return the tables of the planned keys whose job a sweep's folder has finished."""
    try:
        trainings = _read(folder / TRAININGS)
        others = {
            name: dict(list(_read(folder / name).groupby(KEY)))
            for name in (LAPS, LEARNING, STEERING)
            if (folder / name).is_file()
        }
        own = {key: rows for key, rows in trainings.groupby(KEY) if jobs.get(key) == rows["job"].iloc[0]}
        return {
            key: {
                TRAININGS: rows,
                **{name: parts[key] for name, parts in others.items() if key in parts},
            }
            for key, rows in own.items()
        }
    except (KeyError, OSError, ValueError) as error:
        raise RunError(f"also = {folder}: is damaged ({' '.join(str(error).split())}); sweep there again") from error


def _read(path: Path) -> pd.DataFrame:
    """Return a table; what is not trained has the policy ""."""
    return pd.read_csv(path, dtype={"policy": str}).fillna({"policy": ""})
