"""Running jobs: one process each by submitit, as many at once as there is room for; on this machine or by Slurm.

Finished jobs are passed over, interrupted and preempted ones go on from their checkpoint, failed ones are tried again
and then told about; none takes others along. What submitit pickles stays inside the sweep's folder and is removed with
each job.
"""

import fcntl
import getpass
import logging
import os
import shutil
import signal
import subprocess
import time
import uuid
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import submitit

from racerl import bounds
from racerl.documents import read_json, write_text
from racerl.errors import ConfigError, DocumentError, RunError
from racerl.sweep.jobs import Job
from racerl.sweep.work import STATE, STOPPED, work

OWNER, PICKLES, LOGS = ".sweep", ".submitit", "logs"
KINDS = ("local", "slurm")
PERIOD = {"local": 0.5, "slurm": 2.0}  # s between looks at the jobs
STOPS = 50  # that a job is asked to end before it counts as failed: something here wants it gone
TAIL = 400  # characters of a failed job's last words
THREADS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")


@dataclass(frozen=True)
class Status:
    """Where a job is: waiting, running, done or failed, and what its process last said."""

    job: Job
    kind: str
    told: Mapping[str, Any]


@dataclass
class Slot:
    """A job that a process works on."""

    job: Job
    handle: Any  # submitit's
    folder: Path  # of its pickles


@contextmanager
def alone(folder: Path) -> Iterator[None]:
    """Hold a sweep's folder; raise RunError when another sweep does."""
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / OWNER).open("a+") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise RunError(
                f"out = {folder}: another sweep is at work in it; wait for it, or choose another out="
            ) from None
        lock.truncate(0)
        lock.write(uuid.uuid4().hex)
        lock.flush()
        yield


class Engine:
    """Runs jobs; `settings` are those of `conf/engine/*.yaml`."""

    def __init__(self, settings: Mapping[str, Any], threads: int, folder: Path) -> None:
        self.kind = str(settings.get("name"))
        if self.kind not in KINDS:
            raise ConfigError(f"engine.name = {self.kind}: allowed is {' or '.join(KINDS)}")
        if self.kind == "slurm" and not shutil.which("sbatch"):
            raise ConfigError(
                "engine = slurm: sbatch is not there; run it where jobs are submitted, or use engine=local"
            )
        logging.getLogger("submitit").setLevel(logging.ERROR)
        self.settings, self.threads, self.folder = settings, threads, folder
        self.retries = bounds.whole("engine.retries", settings["retries"], 0, 100)
        room = max(1, len(os.sched_getaffinity(0)) // threads)
        self.most = room if settings["jobs"] is None else bounds.whole("engine.jobs", settings["jobs"], 1, 10_000)

    def run(self, jobs: Sequence[Job], on_status: Callable[[Sequence[Status]], None] = lambda rows: None) -> list[Job]:
        """Run all jobs to their end, `alone` in the folder; return those that failed."""
        tries, stops = Counter[str](), Counter[str]()
        waiting = [job for job in jobs if not job.done]
        failed: list[Job] = []
        slots: list[Slot] = []
        try:
            while waiting or slots:
                while waiting and len(slots) < self.most:
                    job = waiting.pop(0)
                    tries[job.name] += 1
                    (job.path / STOPPED).unlink(missing_ok=True)
                    slots.append(self._submit(job))
                time.sleep(PERIOD[self.kind])
                for slot in self._over(slots):
                    slots.remove(slot)
                    if not slot.job.done:
                        self._keep_log(slot)
                        if (slot.job.path / STOPPED).exists() and stops[slot.job.name] < STOPS:
                            stops[slot.job.name] += 1
                            tries[slot.job.name] -= 1  # it has not failed
                        again = tries[slot.job.name] <= self.retries
                        (waiting if again else failed).insert(0, slot.job)
                    shutil.rmtree(slot.folder, ignore_errors=True)
                running = [slot.job for slot in slots]
                on_status([self._status(job, running, waiting, failed) for job in jobs])
        finally:
            # those on this machine end by themselves once the folder is let go
            for slot in slots if self.kind == "slurm" else ():
                slot.handle.cancel()
            shutil.rmtree(self.folder / PICKLES, ignore_errors=True)
        return failed

    def _over(self, slots: Sequence[Slot]) -> list[Slot]:
        """Return the slots whose process has ended."""
        # a cluster without accounting tells submitit nothing of a job that was killed
        queued = _queued() if self.kind == "slurm" else None
        return [
            slot for slot in slots if slot.handle.done() or (queued is not None and slot.handle.job_id not in queued)
        ]

    def _submit(self, job: Job) -> Slot:
        folder = self.folder / PICKLES / uuid.uuid4().hex[:8]
        owner = str((self.folder / OWNER).resolve()) if self.kind == "local" else None
        with _environment(self.threads):
            executor = submitit.AutoExecutor(folder=folder, cluster=self.kind)
            own = ("name", "jobs", "retries")
            options = {key: value for key, value in self.settings.items() if key not in own and value is not None}
            executor.update_parameters(name="racerl", cpus_per_task=self.threads, stderr_to_stdout=True, **options)
            handle = executor.submit(work, job.name, str(job.path.resolve()), job.train, job.races, owner)
        return Slot(job, handle, folder)

    def _keep_log(self, slot: Slot) -> None:
        """Keep what a job that failed has printed."""
        write_text(self.folder / LOGS / f"{slot.job.path.name}.log", slot.handle.stdout() or "")

    def _status(self, job: Job, running: Sequence[Job], waiting: Sequence[Job], failed: Sequence[Job]) -> Status:
        where = {"running": running, "waiting": waiting, "failed": failed}
        kind = next((kind for kind, jobs in where.items() if job in jobs), "done")
        try:
            told = read_json(job.path / STATE) if kind == "running" else {}
        except DocumentError:
            told = {}
        return Status(job, kind, told)

    def last_words(self, job: Job) -> str:
        """Return the last line that a job printed."""
        try:
            lines = (self.folder / LOGS / f"{job.path.name}.log").read_text(errors="replace").strip().splitlines()
        except OSError:
            return "it printed nothing"
        return lines[-1][:TAIL] if lines else "it printed nothing"


def _queued() -> set[str] | None:
    """Return this user's jobs that Slurm knows; None where it does not answer."""
    command = ["squeue", "--noheader", "--format=%A", "--user", getpass.getuser()]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)  # noqa: S603
        return set(done.stdout.split())
    except (OSError, subprocess.SubprocessError):
        return None


@contextmanager
def _environment(threads: int) -> Iterator[None]:
    """Let processes that are started inside compute with this many threads, and leave Ctrl-C to this one."""
    before = {name: os.environ.get(name) for name in THREADS}
    os.environ.update(dict.fromkeys(THREADS, str(threads)))
    heard = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, heard)
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
