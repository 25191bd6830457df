"""Jobs that another sweep has finished, on another machine or another day: their rows stand in for those of this one.

A job's name ends with a hash of all its settings and of the files that they name, so only what was trained with the
very same ones counts, whatever its arm and its sweep were called. Its laps must have been raced from the same starts,
as far, and in all cars that are asked for.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from racerl.documents import read_json
from racerl.errors import ConfigError, DocumentError, RunError
from racerl.run import RunFolder, config_hash
from racerl.sweep.jobs import Plan, identity
from racerl.sweep.tables import KEY, LAPS, LEARNING, RESULTS, STEERING, TRAININGS, read_table

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
            _require_alike(name, run, settings, planned)
            found = _tables(run.path, {key: identity(job.path.name) for key, job in planned.of.items()})
            if not found:
                raise ConfigError(
                    f"also = {name}: none of its trainings is one of this sweep's, their settings differ; "
                    "give both the same words and threads="
                )
            entire = _entire(planned, found) - _entire(planned, tables)
            own = {key: part for key, part in found.items() if planned.of[key].name in entire}
            origins.append({"jobs": len(entire), **{key: run.manifest.get(key) for key in ORIGIN}})
            tables |= own
        return cls(tables, origins)

    def has(self, planned: Plan) -> set[str]:
        """Return the names of the jobs whose every arm is here, so that they need not run."""
        return _entire(planned, self.tables)


def _entire(planned: Plan, keys: Collection[Key]) -> set[str]:
    """Return the names of the jobs of which no arm is missing."""
    return {job.name for job in planned.jobs} - {job.name for key, job in planned.of.items() if key not in keys}


def raced(planned: Plan) -> dict[str, str]:
    """Return a hash of every car that is raced in, by name."""
    cars = {car: (race.record or race.settings)["car"] for job in planned.jobs for (_, car), race in job.races.items()}
    return {name: config_hash(car) for name, car in cars.items()}


NOTHING = Elsewhere({}, ())


def _require_alike(name: str, run: RunFolder, ours: Mapping[str, Any], planned: Plan) -> None:
    theirs = run.settings()
    for key in SAME:
        if theirs.get(key) != ours[key]:
            raise ConfigError(f"also = {name}: has {key} = {theirs.get(key)}, this sweep {ours[key]}; make them equal")
    if not (run.path / RESULTS).is_file():
        raise ConfigError(f"also = {name}: has no {RESULTS}; run that sweep on until it ends")
    try:
        cars = read_json(run.path / RESULTS).get("cars", {})
    except DocumentError as error:
        raise RunError(f"also = {name}: {error}") from error
    for car, content in raced(planned).items():
        if car not in cars:
            raise ConfigError(f"also = {name}: did not race in {car}; leave it out (cars=, twins=) or race it there")
        if cars[car] != content:
            raise ConfigError(
                f"also = {name}: raced in another {car} than conf/car/{car}.yaml is now; sweep there again"
            )


def _tables(folder: Path, jobs: Mapping[Key, str]) -> dict[Key, Tables]:
    """Return the tables of the planned keys whose job a sweep's folder has finished."""
    try:
        tables = {
            name: dict(list(read_table(folder / name).groupby(KEY)))
            for name in (TRAININGS, LAPS, LEARNING, STEERING)
            if (folder / name).is_file()
        }
        known = {identity(rows["job"].iloc[0]): key for key, rows in tables[TRAININGS].items()}
        return {
            key: {
                name: parts[known[job]].assign(**dict(zip(KEY, key, strict=True)))
                for name, parts in tables.items()
                if known[job] in parts
            }
            for key, job in jobs.items()
            if job in known
        }
    except (KeyError, OSError, ValueError) as error:
        raise RunError(f"also = {folder}: is damaged ({' '.join(str(error).split())}); sweep there again") from error
