"""What the process of one job does: train, race in every car, and say how far it is.

It runs in a process group of its own, holds a lock on its folder, and ends when the sweep that started it is gone.
"""

import fcntl
import os
import signal
import threading
import time
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from racerl.documents import write_json
from racerl.evaluate.evaluate import evaluate
from racerl.evaluate.rivals import race
from racerl.interruption import behind, listen
from racerl.record.record import record
from racerl.run import is_complete
from racerl.sweep.jobs import Job, Race, begun_alike
from racerl.train.session import Progress
from racerl.train.train import require_sound, train

STATE, LOCK, STOPPED = "state.json", ".lock", ".stopped"
TRAINING = 0.95  # share of a job
PERIOD = 1.0  # s between looks at the sweep, and at most between words about the state
GRACE = 6.0  # s, in which a job that is asked to end must have


def work(
    name: str, path: str, settings: Mapping[str, Any] | None, races: Mapping[tuple[str, str], Race], owner: str | None
) -> None:
    """Finish a job in its folder, from wherever an earlier process left it.

    `owner` is the file that the sweep keeps locked while it lives; None where jobs outlive it. A job that is asked to
    end says so by a file, for it has not failed.
    """
    job = Job(name, Path(path), settings, races)
    os.setpgid(0, 0)
    listen()  # a cluster's SIGTERM, too: the sweep submits the job anew
    if owner:
        threading.Thread(target=_end_with, args=(Path(owner),), daemon=True).start()
    job.path.mkdir(parents=True, exist_ok=True)
    with (job.path / LOCK).open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # an orphan of an earlier sweep may still be ending
        try:
            _finish(job)
        except BaseException as error:
            if behind(error):
                (job.path / STOPPED).touch()
            raise


def _finish(job: Job) -> None:
    told = 0.0

    def tell(share: float, remark: str, rate: float = 0.0, lap: float | None = None, left: float | None = None) -> None:
        nonlocal told
        if time.monotonic() - told >= PERIOD or share >= 1.0:
            told = time.monotonic()
            facts = {"share": share, "remark": remark, "steps_per_s": rate, "lap_s": lap, "seconds_left": left}
            write_json(job.path / STATE, facts)

    def training(progress: Progress) -> None:
        rate = progress.steps_per_s
        left = (progress.total_steps - progress.steps) / rate if rate else None
        share = TRAINING * progress.steps / progress.total_steps
        remark = "refining" if progress.stage == "refine" else "training"
        tell(share, remark, rate, progress.evaluation.get("mean_lap_s"), left)

    if job.train is not None and not is_complete(job.trained):
        train(job.train, job.trained, training, begun=begun_alike(job))
    if job.train is not None:
        require_sound(job.trained)
    before = 0.0 if job.train is None else TRAINING
    each = (1.0 - before) / len(job.races)

    def racing(number: int, what: str, share: float, remark: str) -> None:
        tell(before + each * (number + share), f"racing ({what}), {remark}")

    for number, ((policy, car), asked) in enumerate(job.races.items()):
        _race(asked, job.race(policy, car), partial(racing, number, f"{policy}, {car}" if policy else car))
    tell(1.0, "done")


def _race(asked: Race, out: Path, tell: Callable[[float, str], None]) -> None:
    """Finish one race, after the drive that it scores, if it does."""
    tell(0.0, "getting ready")
    if asked.record is not None and not is_complete(Path(asked.record["out"])):
        record(asked.record, Path(asked.record["out"]), lambda share: tell(share, "being driven"))
    if not is_complete(out):
        (race if "controller" in asked.settings else evaluate)(asked.settings, out, tell)


def _end_with(owner: Path) -> None:
    """End this process once nobody holds the owner's lock, or somebody else does."""
    first = _identity(owner)
    while first and _identity(owner) == first:
        time.sleep(PERIOD)
    os.kill(os.getpid(), signal.SIGTERM)  # a training keeps what it has
    time.sleep(GRACE)
    os._exit(1)


def _identity(owner: Path) -> str:
    """Return what the holder of a lock has written into it, nothing where nobody holds it."""
    try:
        with owner.open() as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
            except BlockingIOError:
                return lock.read()
            return ""
    except OSError:
        return ""
