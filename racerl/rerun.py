"""`racerl rerun RUN`: a finished run once more from its own configuration, compared with itself file by file.

Tables and weights must be the same byte for byte; JSON, but for what the clock or the commit says; of a training's
course every number, but the clock's. Pages, pictures and TensorBoard's files are drawn from these, and left out.
"""

import json
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from racerl.choices import optional_groups, own_keys
from racerl.data.survey import survey
from racerl.documents import MAX_TEXT_BYTES, read_json, read_text, write_json
from racerl.env.black_box import FILE as FAILED
from racerl.errors import ConfigError, RunError
from racerl.evaluate.evaluate import evaluate
from racerl.evaluate.rivals import race
from racerl.gap.diagnose import gap
from racerl.gap.plan import plan
from racerl.identify.identify import identify
from racerl.optimum.optimum import optimum
from racerl.record.record import record
from racerl.report.track import show_track
from racerl.run import CONFIG, MANIFEST, Compose, RunFolder, is_complete
from racerl.sweep.sweep import sweep
from racerl.sweep.tables import TRAININGS as TABLE
from racerl.train.checkpoint import FILE as TRAINING
from racerl.train.close import close
from racerl.train.improve import FILE as IMPROVING
from racerl.train.session import PROGRESS
from racerl.train.train import train
from racerl.tune.tune import tune

RESULT, AGAIN = "rerun.json", "again"
STAGES: dict[str, Callable[..., Any]] = {
    "train": train,
    "evaluate": evaluate,
    "race": race,
    "record": record,
    "identify": identify,
    "gap": gap,
    "gap plan": plan,
    "optimum": optimum,
    "tune": tune,
    "data": survey,
    "track": show_track,
    "sweep": sweep,
    "close": close,
}
COMPOSING = ("gap plan", "sweep", "close")  # compose the settings of other stages
COMMANDS = {"gap plan": "gap"}  # whose keys a stage has, where they are not its own
CLOCK = {"seconds", "training_s", "clean_after_s", "git_sha", "run", "run_id"}  # keys that no two runs share
SKIPPED_FOLDERS = {"tensorboard", "logs", "checkpoint"}
SKIPPED = {MANIFEST, CONFIG, "state.json", RESULT, FAILED}
CHECKPOINTS = (TRAINING, IMPROVING)  # that a run which was killed at its very end has left
ARRIVALS = re.compile(r"to_\d+")  # seconds until a lap was so near the optimum
SKIPPED_SUFFIXES = {".html", ".svg"}
MACHINE = ("racerl", "git_sha", "uncommitted", "python", "libraries", "cpu", "threads", "device")
SHOWN = 5  # differences of a document that are told


@dataclass(frozen=True)
class Difference:
    """A file that is not as it was, and in what."""

    file: str
    what: str


def rerun(settings: Mapping[str, Any], out: Path, compose: Compose) -> dict[str, Any]:
    """Do the run of `settings["run"]` again below `out`; return what is written to rerun.json.

    Raises RunError for a run that is not complete, that nobody can do again, or whose configuration is another's.
    """
    if not isinstance(settings["run"], str):
        raise ConfigError(f"run = {settings['run']}: the folder of a finished run is expected")
    before = RunFolder.open_complete(Path(settings["run"]))
    stored = before.settings()
    stage = before.manifest["stage"]
    if stage == "sweep":  # how its jobs were run is no part of it
        stored = {**compose("sweep", [f"name={stored.get('name')}"]), **stored}
    kind = "race" if stage == "evaluate" and "controller" in stored else stage
    if kind not in STAGES:
        raise RunError(f"{before.path}: a {stage} run is not done again; allowed are {', '.join(STAGES)}")
    command = COMMANDS.get(kind, kind)
    if missing := sorted(own_keys(command) - optional_groups(command) - set(stored)):
        raise RunError(f"{before.path}: {CONFIG} lacks '{missing[0]}', which this version of racerl needs")
    folder = RunFolder.start(out, "rerun", settings)
    path = folder.path / AGAIN / before.path.resolve().name
    if not is_complete(path):
        own = {**stored, "out": str(path)}
        try:
            STAGES[kind](own, path, *([compose] if kind in COMPOSING else []))
        except RunError:
            if not is_complete(path):  # or it has diverged, as it may have before
                raise
    after = RunFolder.open_complete(path, stage)
    differences = compare(before.path, path)
    facts = {
        "run": settings["run"],
        "stage": stage,
        "same": not differences,
        "files": sorted(_files(before.path)),
        "differences": [{"file": each.file, "what": each.what} for each in differences],
        "changed": list(_changed(before.manifest, after.manifest)),
    }
    write_json(folder.path / RESULT, facts)
    folder.finish(same=facts["same"])
    return facts


def compare(before: Path, after: Path) -> list[Difference]:
    """Return what differs between two runs of the same settings."""
    return list(_differences(before, after, sorted(_files(before))))


def _files(run: Path) -> Iterator[str]:
    """Yield the files of a run that are compared, as paths inside it."""
    for path in run.rglob("*"):
        inside = path.relative_to(run)
        hidden = any(part.startswith(".") for part in inside.parts)
        skipped = path.name in SKIPPED or path.suffix in SKIPPED_SUFFIXES or path.name.endswith(CHECKPOINTS)
        skipped = skipped or not SKIPPED_FOLDERS.isdisjoint(inside.parts)
        if path.is_file() and not path.is_symlink() and not hidden and not skipped:
            yield str(inside)


def _differences(before: Path, after: Path, files: list[str]) -> Iterator[Difference]:
    for file in files:
        one, other = before / file, after / file
        if not other.is_file():
            yield Difference(file, "is not there any more")
        elif one.suffix == ".json":
            told = [f"{key}: {a} → {b}" for key, a, b in _unlike(read_json(one), read_json(other))]
            if told:
                yield Difference(
                    file, "; ".join(told[:SHOWN]) + (f" and {len(told) - SHOWN} more" * (len(told) > SHOWN))
                )
        elif one.name == TABLE:
            if not _timeless(one).equals(_timeless(other)):
                yield Difference(file, "other numbers")
        elif one.name == PROGRESS:
            if (line := _first_unlike(_course(one), _course(other))) is not None:
                yield Difference(file, f"from line {line + 1} on")
        elif one.read_bytes() != other.read_bytes():
            yield Difference(file, "other bytes")
    for file in sorted(set(_files(after)) - set(files)):
        yield Difference(file, "was not there before")


def _unlike(one: Any, other: Any, where: str = "") -> Iterator[tuple[str, Any, Any]]:
    """Yield the places where two documents differ, with both values."""
    if isinstance(one, dict) and isinstance(other, dict):
        for key in sorted(({*one} | {*other}) - CLOCK):
            if ARRIVALS.fullmatch(key):
                continue
            yield from _unlike(one.get(key), other.get(key), f"{where}.{key}".lstrip("."))
    elif isinstance(one, list) and isinstance(other, list) and len(one) == len(other):
        for i, (a, b) in enumerate(zip(one, other, strict=True)):
            yield from _unlike(a, b, f"{where}[{i}]")
    elif one != other:
        yield where, one, other


def _timeless(path: Path) -> pd.DataFrame:
    """Return a sweep's table of trainings without what the clock says."""
    table = pd.read_csv(path)
    return table[[name for name in table if name not in CLOCK and not ARRIVALS.fullmatch(str(name))]]


def _course(path: Path) -> list[dict[str, Any]]:
    """Return the lines of a training's course without what the clock says."""
    try:
        lines = [json.loads(line) for line in read_text(path, 16 * MAX_TEXT_BYTES).splitlines()]
    except (ValueError, RecursionError) as error:
        raise RunError(f"{path}: cannot be read ({error}); there is nothing to compare with") from error
    return [{key: value for key, value in line.items() if not key.startswith("time/")} for line in lines]


def _first_unlike(one: list[Any], other: list[Any]) -> int | None:
    pairs = zip([*one, None], [*other, None], strict=False)
    return next((i for i, (a, b) in enumerate(pairs) if a != b), None)


def _changed(before: Mapping[str, Any], after: Mapping[str, Any]) -> Iterator[str]:
    """Yield what is no longer as it was in the machine and the software."""
    for key in MACHINE:
        if before.get(key) != after.get(key):
            yield f"{key}: {before.get(key)} then, {after.get(key)} now"
    files, now = (manifest.get("files") or {} for manifest in (before, after))
    yield from (f"{path}: another content now" for path, content in files.items() if now.get(path, content) != content)
