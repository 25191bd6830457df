"""Trackio: a dashboard for the runs of a project, in a database on this machine; no account, no network.

Numbers are written at once into the database that `trackio show` reads (the folder `TRACKIO_DIR`, by default that of
Trackio), under the run's own id. Each record has a name of its own: what a killed training wrote behind its checkpoint,
and writes again when it goes on, is there once. `trackio sync` is how a user sends a project elsewhere.
"""

import logging
import re
import sqlite3
import zlib
from dataclasses import dataclass
from typing import Any

from stable_baselines3.common.logger import KVWriter

from racerl.errors import ConfigError
from racerl.run import RunFolder

log = logging.getLogger(__name__)

STAGE = "train"  # a folder of this name is a part of what the one above it is, as of a sweep's job


@dataclass(frozen=True)
class Trackio:
    """Its settings; raises ConfigError where Trackio is not installed, or takes no project of that name."""

    project: str

    def __post_init__(self) -> None:
        if not isinstance(self.project, str) or not re.fullmatch(r"[\w-]+", self.project):
            raise ConfigError(f"tracking.project = {self.project!r}: letters, digits, - and _ are expected")
        _storage().validate_project_name(self.project)  # a ValueError where Trackio keeps the name for itself

    def follow(self, folder: RunFolder) -> "Records":
        """Return what writes a run's numbers into the project."""
        return Records(self.project, folder)


class Records(KVWriter):
    """Writes what TensorBoard is given; a database that cannot be written to stops no training."""

    def __init__(self, project: str, folder: RunFolder) -> None:
        self.storage, self.project = _storage(), project
        path = folder.path.resolve()
        self.run_id = folder.manifest["run_id"]
        self.name = path.parent.name if path.name == STAGE else path.name
        self.settings = {key: value for key, value in folder.settings().items() if key != "out"}
        self.broken = False

    def write(self, key_values: dict[str, Any], key_excluded: dict[str, tuple[str, ...]], step: int = 0) -> None:
        """Write one record of the logger."""
        given = sorted(key for key in key_values if "tensorboard" not in key_excluded[key])
        numbers = {key: float(key_values[key]) for key in given if not isinstance(key_values[key], str)}
        if self.broken or not numbers:
            return
        try:
            self.storage.bulk_log(
                project=self.project,
                run=self.name,
                run_id=self.run_id,
                metrics_list=[numbers],
                steps=[step],
                config=self.settings,
                log_ids=[f"{self.run_id}:{step}:{zlib.crc32(' '.join(numbers).encode()):08x}"],
            )
        except (sqlite3.Error, OSError, RuntimeError) as error:
            self.broken = True
            log.warning("tracking=trackio: %s; the training goes on without", error)

    def close(self) -> None:
        """Nothing is kept open."""


def _storage() -> Any:
    try:
        from trackio.sqlite_storage import SQLiteStorage
    except ModuleNotFoundError as error:
        raise ConfigError("tracking=trackio needs trackio: in your clone, pip install -e '.[tracking]'") from error
    return SQLiteStorage
