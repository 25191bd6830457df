"""The run folder: what every stage writes its results into, with a manifest that says where they came from.

`manifest.json` holds the format, the stage, its status (running, complete), the run's id, the words that asked for it,
the seed, versions, threads, CPU, git sha and a hash of what is not committed. A folder that already holds another run,
or that another process is at work in, is never written into.
"""

import fcntl
import hashlib
import json
import logging
import os
import platform
import subprocess
import weakref
from collections.abc import Callable, Mapping, Sequence
from contextvars import ContextVar
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Any

import racerl
from racerl.documents import read_json, read_yaml, sweep, write_json, write_yaml
from racerl.errors import DocumentError, RunError

FORMAT = 1
MANIFEST, CONFIG = "manifest.json", "config.yaml"
MAX_DEPTH = 3  # folders below outputs/<stage>
WORDS: ContextVar[Sequence[str] | None] = ContextVar("words", default=None)  # of the user, on the command line
LOCK = ".lock"
Compose = Callable[[str, Sequence[str]], dict[str, Any]]  # settings of another stage, from its name and overrides
log = logging.getLogger(__name__)
LIBRARIES = ("torch", "stable-baselines3", "numpy", "casadi")


def config_hash(settings: Mapping[str, Any]) -> str:
    """Return a hash of the settings that decide a result; `out` and `tracking` do not."""
    decisive = {key: value for key, value in settings.items() if key not in ("out", "tracking")}
    return hashlib.sha256(json.dumps(decisive, sort_keys=True, default=str).encode()).hexdigest()[:16]


def provenance() -> dict[str, Any]:
    """Return versions, machine and git sha; never a path or a host name."""
    return {
        "racerl": racerl.__version__,
        "git_sha": git_sha(),
        "uncommitted": uncommitted(),
        "python": platform.python_version(),
        "libraries": {name: metadata.version(name) for name in LIBRARIES},
        "cpu": cpu_name(),
        "cpu_count": os.cpu_count(),
    }


def git_sha() -> str | None:
    """Return the commit of the checkout that racerl runs from, with "+changes" when it is dirty; None in a wheel."""
    sha, changes = _git("rev-parse", "HEAD"), _git("status", "--porcelain", "--untracked-files=no")
    return None if sha is None or changes is None else sha + ("+changes" if changes else "")


def uncommitted() -> str | None:
    """Return a hash of what the checkout's tracked files have beside its commit; None where nothing, or in a wheel."""
    changes = _git("diff", "HEAD")
    return hashlib.sha256(changes.encode()).hexdigest()[:16] if changes else None


class _Hold:
    """Holds a folder against other processes, until nobody in this one holds it any more."""

    def __init__(self, path: Path, stage: str) -> None:
        self.handle = -1
        for self.what, flags in ((path, os.O_RDONLY), (path / LOCK, os.O_RDWR | os.O_CREAT)):  # NFS locks no folders
            self.handle = os.open(self.what, flags, 0o644)
            try:
                fcntl.flock(self.handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                line = f"out = {path}: another {stage} is at work in it; wait for it, or choose another out="
                raise RunError(line) from None
            except OSError:
                os.close(self.handle)
                self.handle = -1
            else:
                return
        log.info("%s: cannot be held against other processes here", path)

    def __del__(self) -> None:
        if self.handle >= 0:
            os.close(self.handle)

    def here(self) -> bool:
        """Return whether what is held is still there, and not another of the same name."""
        try:
            return os.path.samestat(os.fstat(self.handle), self.what.stat())
        except OSError:
            return False

    def remove(self) -> None:
        """Remove the file that a folder is held by, where that is one."""
        if self.what.name == LOCK and self.here():
            self.what.unlink(missing_ok=True)

    @classmethod
    def of(cls, path: Path, stage: str) -> "_Hold":
        """Return what this process holds a folder by; raise RunError where another process does."""
        held = _holds.get(path.resolve())
        if held is None or not held.here():
            held = _holds[path.resolve()] = cls(path, stage)
        return held


_holds: weakref.WeakValueDictionary[Path, _Hold] = weakref.WeakValueDictionary()


def _git(*arguments: str) -> str | None:
    """Return what git says of the checkout that racerl runs from; None in a wheel, or where git does not answer."""
    root = Path(racerl.__file__).resolve().parent.parent
    if not (root / ".git").exists():
        return None
    command = ["git", "-C", str(root), *arguments]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True, timeout=10).stdout.strip()  # noqa: S603
    except (OSError, ValueError, subprocess.SubprocessError):  # ValueError: bytes that are no text
        return None


def cpu_name() -> str:
    """Return the processor's model name."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        return next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()


class RunFolder:
    """One stage's results; created by `start` or opened by `open_complete`."""

    def __init__(self, path: Path, manifest: dict[str, Any], hold: _Hold | None = None) -> None:
        self.path = path
        self.manifest = manifest
        self._hold = hold  # let go with this object, whatever becomes of the stage

    @classmethod
    def start(
        cls, path: Path, stage: str, settings: Mapping[str, Any], *, again: bool = False, **facts: Any
    ) -> "RunFolder":
        """Create the folder, or continue an interrupted run of the same configuration in it; `again` a finished one.

        Raises RunError when the folder holds anything else: results are never overwritten.
        """
        identity = config_hash(settings)
        if path.exists() and not path.is_dir():
            raise RunError(f"out = {path}: is a file; give a folder")
        try:
            path.mkdir(parents=True, exist_ok=True)
            began = path.resolve() not in _holds
            hold = _Hold.of(path, stage)
            try:
                folder = cls._start(path, stage, settings, identity, again, facts)
            except BaseException:
                if began:
                    hold.remove()
                raise
            return cls(path, folder.manifest, hold)
        except OSError as error:
            raise RunError(f"out = {path}: cannot be written ({error.strerror}); choose another out=") from error

    @classmethod
    def _start(
        cls, path: Path, stage: str, settings: Mapping[str, Any], identity: str, again: bool, facts: Mapping[str, Any]
    ) -> "RunFolder":
        if (path / MANIFEST).is_file():
            folder = cls._open(path)
            if folder.manifest["config_hash"] != identity or folder.manifest["stage"] != stage:
                raise RunError(
                    f"out = {path}: already holds another {folder.manifest['stage']} run; choose another out="
                )
            if folder.manifest["status"] == "complete" and not again:
                raise RunError(f"out = {path}: already holds this very run, complete; choose another out=")
            sweep(path)
            if not (path / CONFIG).is_file():  # killed before it was written
                write_yaml(path / CONFIG, settings)
            return folder
        if any(each.name != LOCK and not each.name.startswith(f".{MANIFEST}.") for each in path.iterdir()):
            raise RunError(f"out = {path}: is not empty and holds no racerl run; choose another out=")
        manifest = {
            "format": FORMAT,
            "stage": stage,
            "status": "running",
            "run_id": f"{identity}-{os.urandom(4).hex()}",
            "config_hash": identity,
            "words": None if (words := WORDS.get()) is None else list(words),
            "started": datetime.now(UTC).isoformat(timespec="seconds"),
            **provenance(),
            **facts,
        }
        write_json(path / MANIFEST, manifest)
        write_yaml(path / CONFIG, settings)
        return cls(path, manifest)

    @classmethod
    def open_complete(cls, path: Path, stage: str | None = None) -> "RunFolder":
        """Open a finished run; raise RunError when it is missing, incomplete or of another version or stage."""
        folder = cls.open(path, stage)
        if folder.manifest["status"] != "complete":
            raise RunError(f"{path}: the run is not complete; run the same command with out={path} to continue it")
        return folder

    @classmethod
    def open(cls, path: Path, stage: str | None = None) -> "RunFolder":
        """Open a run, finished or not; raise RunError when it is missing or of another version or stage."""
        folder = cls._open(path)
        if stage and folder.manifest["stage"] != stage:
            raise RunError(f"{path}: is a {folder.manifest['stage']} run, a {stage} run was expected")
        return folder

    @classmethod
    def _open(cls, path: Path) -> "RunFolder":
        if not (path / MANIFEST).is_file():
            raise RunError(f"{path}: is no racerl run folder ({MANIFEST} is missing)")
        try:
            manifest = read_json(path / MANIFEST)
        except DocumentError as error:
            raise RunError(str(error)) from error
        if manifest.get("format") != FORMAT:
            raise RunError(f"{path}: run format {manifest.get('format')!r}, this racerl reads {FORMAT}; run it again")
        for key in ("stage", "status", "run_id", "config_hash"):
            if not isinstance(manifest.get(key), str):
                raise RunError(f"{path}: {MANIFEST} has no '{key}'; the folder is damaged, run it again")
        return cls(path, manifest)

    def settings(self) -> dict[str, Any]:
        """Return the resolved configuration of the run."""
        try:
            return read_yaml(self.path / CONFIG)
        except DocumentError as error:
            raise RunError(f"{self.path}: {error}") from error

    def finish(self, **facts: Any) -> None:
        """Mark the run complete and add what is known now."""
        finished = datetime.now(UTC).isoformat(timespec="seconds")
        self.manifest = {**self.manifest, "status": "complete", "finished": finished, **facts}
        write_json(self.path / MANIFEST, self.manifest)
        if self._hold is not None:
            self._hold.remove()
            self._hold = None


def is_complete(path: Path) -> bool:
    """Return whether a folder holds a finished run."""
    try:
        RunFolder.open_complete(path)
    except RunError:
        return False
    return True


def find_runs(outputs: Path) -> list[RunFolder]:
    """Return the complete runs up to `MAX_DEPTH` folders below one, oldest first; what is no run is passed over."""
    found = []
    for depth in range(1, MAX_DEPTH + 1):
        for manifest in outputs.glob("/".join(["*"] * depth) + f"/{MANIFEST}"):
            try:
                found.append(RunFolder.open_complete(manifest.parent))
            except RunError:
                continue
    return sorted(found, key=lambda run: (str(run.manifest.get("started")), str(run.path)))
