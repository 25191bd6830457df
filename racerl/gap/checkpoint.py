"""Checkpoints: finished fits of a diagnosis, so that an interrupted one goes on behind them to the very same verdict.

Every part is a file of plain arrays, named after a hash of all that it was worked out from: the settings, the log's
rows, racerl's version and machine, and its own inputs. What was worked out from anything else has another name and is
never read; nor is what a digest in front of it says is damaged.
"""

import hashlib
import json
import logging
import shutil
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors.numpy import load, save

from racerl.documents import read_sealed, write_sealed
from racerl.errors import DocumentError, RunError
from racerl.gap.evidence import Evidence
from racerl.run import config_hash, provenance

Parts = dict[str, NDArray[Any]]
FOLDER, SUFFIX = "checkpoint", ".safetensors"
MOST_BYTES = 2**32

log = logging.getLogger(__name__)


class Checkpoint:
    """A folder of finished parts; without one nothing is kept."""

    def __init__(self, folder: Path | None = None) -> None:
        self.folder = folder
        self._recalled: dict[str, Parts] = {}

    @classmethod
    def of(cls, run: Path, settings: Mapping[str, Any], evidence: Mapping[str, Evidence]) -> "Checkpoint":
        """Return the checkpoint of a run folder, for these settings and windows; say where there is another's."""
        about = [config_hash(settings), provenance(), {name: asdict(each) for name, each in evidence.items()}]
        folder = run / FOLDER / _hash(about)
        if (run / FOLDER).is_dir() and any(path != folder for path in (run / FOLDER).iterdir()):
            log.warning("%s: belongs to other logs, another racerl or another machine; it is not used", run / FOLDER)
        return cls(folder)

    @staticmethod
    def key(*inputs: Any) -> str:
        """Return the name of what is worked out from some inputs: arrays, numbers, text, lists and mappings of them."""
        return _hash(inputs)

    def find(self, key: str) -> Parts | None:
        """Return a finished part; None where there is none that is whole."""
        if self.folder is None or not (path := self.folder / f"{key}{SUFFIX}").is_file():
            return None
        try:
            content = read_sealed(path, MOST_BYTES, key)
        except DocumentError:
            log.warning("%s: is damaged; what it held is worked out again", path)
            return None
        return {name: np.array(part) for name, part in load(content).items()}

    def keep(self, key: str, parts: Parts) -> None:
        """Keep a finished part; raise RunError where it cannot be written."""
        if self.folder is None:
            return
        content = save({name: np.ascontiguousarray(part) for name, part in parts.items()})
        try:
            write_sealed(self.folder / f"{key}{SUFFIX}", content, key)
        except OSError as error:
            raise RunError(f"{self.folder}: cannot be written ({error.strerror}); give another out=") from error

    def recall(self, key: str, make: Callable[[], Parts]) -> Parts:
        """Return a finished part, or make and keep it; what was asked for once stays at hand."""
        if key not in self._recalled:
            found = self.find(key)
            if found is None:
                found = make()
                self.keep(key, found)
            self._recalled[key] = found
        return self._recalled[key]

    @staticmethod
    def remove(run: Path) -> None:
        """Remove what a finished run needs no longer."""
        shutil.rmtree(run / FOLDER, ignore_errors=True)


def _hash(inputs: Any) -> str:
    """Return a hash of some inputs; the order of a mapping, which may be that of a set, says nothing."""
    return hashlib.sha256(json.dumps(inputs, sort_keys=True, default=_told).encode()).hexdigest()[:32]


def _told(part: Any) -> Any:
    """Return what stands for an array in a hash."""
    if not isinstance(part, np.ndarray):
        raise TypeError(f"{type(part).__name__} has no content to hash")
    return [str(part.dtype), part.shape, hashlib.sha256(part.tobytes()).hexdigest()]
