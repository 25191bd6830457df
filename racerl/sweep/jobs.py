"""The jobs of a sweep: one training each, and its races in every car. Arms that train alike share a job.

A training that ends with a refinement races twice: with its policy as it was learned, and refined. A job's folder
holds `train/` and a race in every car below `learned/` and `refined/`; that of what is not trained just the races.

Arms whose words name a controller=, a driver's drive= or a drive to be scored, run=, train nothing: one job for all
seeds, in the world (vehicle, track, …) of the others.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from racerl.assemble import files_read
from racerl.control.policy import FACTS, UNREFINED, improved_by, load_policy
from racerl.documents import content_hash
from racerl.errors import ConfigError, RacerlError
from racerl.run import Compose, RunFolder, config_hash, is_complete
from racerl.sweep.definition import Sweep
from racerl.train.train import beginning

UNTRAINED = -1  # stands for the seed of what is not trained
LEARNED, REFINED = "learned", "refined"  # policies of one training
WORLD = {  # groups of a training's words that hold for a stage, too
    "race": ("vehicle", "track", "sim", "action"),
    "record": ("vehicle", "track", "sim"),
    "evaluate": ("track",),
}
STAGES = {"controller": "race", "drive": "record", "run": "evaluate"}  # by a word of such arms
SLOWEST_LAP, LONGEST_RUN = 15.0, 600.0  # s, of a driver that is recorded


def policies(found: Iterable[str]) -> list[str]:
    """Return the policies of trainings among those found, as learned first; "" alone where nothing was trained."""
    known = set(found)
    return [policy for policy in (LEARNED, REFINED) if policy in known] or [""]


@dataclass(frozen=True)
class Race:
    """One car's race, perhaps of a drive that is recorded first; all are settings."""

    settings: Mapping[str, Any]
    record: Mapping[str, Any] | None = None


@dataclass(frozen=True)
class Job:
    """One training and its races; `name` is its own among the jobs, `path` its folder."""

    name: str
    path: Path
    train: Mapping[str, Any] | None  # settings; None for what is not trained
    races: Mapping[tuple[str, str], Race]  # by policy ("" for what is not trained) and car

    @property
    def seed(self) -> int:
        """Seed of the training."""
        return UNTRAINED if self.train is None else int(self.train["seed"])

    @property
    def trained(self) -> Path:
        """Folder of the training run."""
        return self.path / "train"

    @property
    def policies(self) -> list[str]:
        """The policies that race, as learned first."""
        return policies(policy for policy, _ in self.races)

    def race(self, policy: str, car: str) -> Path:
        """Return the folder of a policy's race in a car."""
        return self.path / policy / car

    @property
    def done(self) -> bool:
        """Whether everything is there."""
        trained = self.train is None or is_complete(self.trained)
        return trained and all(is_complete(self.race(policy, car)) for policy, car in self.races)


@dataclass(frozen=True)
class Plan:
    """Which job answers for every arm and seed of every sweep."""

    sweeps: Sequence[Sweep]
    jobs: Sequence[Job]
    of: Mapping[tuple[str, str, int], Job]  # sweep, arm, seed

    @property
    def trial_steps(self) -> int | None:
        """Control steps of its trainings where their budget is a trial; None where it is meant to learn."""
        budgets = [job.train["budget"] for job in self.jobs if job.train is not None]
        return max((int(budget["steps"]) for budget in budgets if budget.get("trial")), default=None)


def plan(sweeps: Sequence[Sweep], settings: Mapping[str, Any], out: Path, compose: Compose) -> Plan:
    """Return the jobs of some sweeps under `out`; raise ConfigError for arms that cannot be composed."""
    jobs: dict[str, Job] = {}
    of = {}
    for sweep in sweeps:
        for arm, words in sweep.arms.items():
            rival = any(_key(word) in STAGES for word in words)
            for seed in [UNTRAINED] if rival else settings["seeds"] or sweep.seeds:
                if rival:
                    job = _rival(arm, [*sweep.base, *map(str, settings["words"])], words, settings, out, compose)
                else:
                    job = _training(arm, [*sweep.base, *words], seed, settings, out, compose)
                own = identity(job.path.name)
                if own not in jobs:
                    taken = any(known.name == job.name for known in jobs.values())  # by an arm of another sweep
                    jobs[own] = replace(job, name=job.path.name) if taken else job
                of[sweep.name, arm, seed] = jobs[own]
    return Plan(sweeps, _in_order(jobs.values()), of)


def identity(name: str) -> str:
    """Return the hash at the end of the name of a job's folder; in front stands the arm that came first."""
    return name.rpartition("-")[2]


def _in_order(jobs: Collection[Job]) -> list[Job]:
    """Return the jobs seed by seed, so that an interrupted sweep has all arms of the first.

    Rivals come behind its trainings, whose words may be wrong, and before those of other seeds, for they may take long.
    """
    first = min((job.seed for job in jobs if job.train is not None), default=UNTRAINED)
    return sorted(jobs, key=lambda job: (first, 1) if job.train is None else (job.seed, 0))


def _training(
    arm: str, words: Sequence[str], seed: int, settings: Mapping[str, Any], out: Path, compose: Compose
) -> Job:
    # what differs from job to job is put in here: composing takes a quarter of a second, the same words once
    own = [*map(str, settings["words"]), f"threads={settings['threads']}"]
    if any(_key(word) == "seed" for word in (*words, *own)):
        raise ConfigError("seed=…: a sweep has several; give seeds=[0,1]")
    train = {**compose("train", [*words, *own]), "seed": seed}
    files = list(files_read(train).values())
    path = out / "jobs" / f"{arm}-{seed}-{config_hash({**train, 'files': files} if files else train)[:6]}"
    trained, races = path / "train", {}
    refined = improved_by(train["budget"])
    for policy, run in {LEARNED: trained / UNREFINED, REFINED: trained}.items() if refined else [(LEARNED, trained)]:
        for car in settings["cars"]:
            asked = ["run=policy", f"laps={settings['laps']}", f"seeds={list(settings['starts'])}", f"car={car}"]
            places = {"run": str(run), "out": str(path / policy / car)}
            races[policy, car] = Race({**compose("evaluate", asked), **places})
    return Job(f"{arm}-{seed}", path, {**train, "out": str(trained)}, races)


def _rival(
    arm: str, base: Sequence[str], own: Sequence[str], settings: Mapping[str, Any], out: Path, compose: Compose
) -> Job:
    """Return the job of an arm that races in the world of the others: of their words, those about the world count."""
    stage = next(STAGES[key] for word in own if (key := _key(word)) in STAGES)
    said = {_key(word) for word in own}
    words = [*(word for word in base if _group(word) in WORLD[stage] and _key(word) not in said), *own]
    path = out / "jobs" / f"{arm}-{config_hash({**compose(stage, words), 'files': _contents(_named(words))})[:6]}"
    laps, starts = settings["laps"], list(settings["starts"])
    races = {}
    for car in settings["cars"]:
        raced = [*words, f"car={car}"]
        if stage == "race":
            asked = [f"laps={laps}", f"seeds={starts}", f"threads={settings['threads']}", f"out='{path / car}'"]
            races["", car] = Race(compose("race", [*raced, *asked]))
        elif stage == "evaluate":
            races["", car] = Race(compose("evaluate", [*raced, f"out='{path / car}'"]))
        else:
            block = min(LONGEST_RUN, SLOWEST_LAP * (laps + 1))
            asked = [f"seconds={block * len(starts)}", f"drive.block={block}", f"out='{path / car}_drive'"]
            record = compose("record", [*raced, *asked])
            log = Path(record["out"]) / record["file"]
            score = compose("evaluate", [f"run='{log}'", f"out='{path / car}'"])
            races["", car] = Race({**score, "track": record["track"]}, record)
    return Job(arm, path, None, races)


def _key(word: str) -> str:
    return word.lstrip("+~").partition("=")[0]


def _group(word: str) -> str:
    return _key(word).partition(".")[0].partition("/")[0]


def _named(words: Sequence[str]) -> list[Path]:
    return [Path(word.partition("=")[2]) for word in words]


def begun_alike(job: Job) -> Path | None:
    """Return another job's training that begins as this one does and is through with that; None where there is none."""
    if job.train is None or not improved_by(job.train["budget"]):
        return None
    files, begins = files_read(job.train), beginning(job.train)
    for facts in sorted(job.path.parent.glob(f"*/{job.trained.name}/{UNREFINED}/{FACTS}")):
        run = facts.parents[1]
        with suppress(OSError, RacerlError, KeyError, TypeError, AttributeError):  # damaged
            folder = RunFolder.open(run, "train")
            same = folder.manifest.get("files") == files  # by content
            if same and run != job.trained and beginning(folder.settings()) == begins:
                load_policy(run / UNREFINED)
                return run
    return None


def _contents(paths: Sequence[Path]) -> list[str]:
    """Return hashes of the files that are there, so that another content makes another job."""
    return [content_hash(path) for path in paths if path.is_file()]
