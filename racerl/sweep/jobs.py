"""The jobs of a sweep: one training each, and its races in every car. Arms that train alike share a job."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from racerl.run import Compose, config_hash, is_complete
from racerl.sweep.definition import Sweep


@dataclass(frozen=True)
class Job:
    """One training and its races; `name` is its own among the jobs, `path` its folder."""

    name: str
    path: Path
    train: Mapping[str, Any]  # settings
    races: Mapping[str, Mapping[str, Any]]  # car → settings

    @property
    def trained(self) -> Path:
        """Folder of the training run."""
        return self.path / "train"

    def race(self, car: str) -> Path:
        """Return the folder of the race in a car."""
        return self.path / car

    @property
    def done(self) -> bool:
        """Whether everything is there."""
        return is_complete(self.trained) and all(is_complete(self.race(car)) for car in self.races)


@dataclass(frozen=True)
class Plan:
    """Which job answers for every arm and seed of every sweep."""

    sweeps: Sequence[Sweep]
    jobs: Sequence[Job]
    of: Mapping[tuple[str, str, int], Job]  # sweep, arm, seed


def plan(sweeps: Sequence[Sweep], settings: Mapping[str, Any], out: Path, compose: Compose) -> Plan:
    """Return the jobs of some sweeps under `out`; raise ConfigError for arms that cannot be composed."""
    jobs: dict[str, Job] = {}
    of = {}
    words = [*map(str, settings["words"]), f"threads={settings['threads']}"]
    for sweep in sweeps:
        for seed in settings["seeds"] or sweep.seeds:
            for arm, own in sweep.arms.items():
                train = compose("train", [*sweep.base, *own, *words, f"seed={seed}"])
                identity = config_hash(train)
                if identity not in jobs:
                    path, name = out / "jobs" / f"{arm}-{seed}-{identity[:6]}", f"{arm}-{seed}"
                    taken = any(job.name == name for job in jobs.values())  # by an arm of another sweep
                    jobs[identity] = _job(path.name if taken else name, path, train, settings, compose)
                of[sweep.name, arm, seed] = jobs[identity]
    # seed by seed, so that an interrupted sweep has all arms of the first
    return Plan(sweeps, sorted(jobs.values(), key=lambda job: int(job.train["seed"])), of)


def _job(name: str, path: Path, train: dict[str, Any], settings: Mapping[str, Any], compose: Compose) -> Job:
    run = f"run='{path / 'train'}'"
    words = [run, f"laps={settings['laps']}", f"seeds={list(settings['starts'])}"]
    races = {car: compose("evaluate", [*words, f"car={car}", f"out='{path / car}'"]) for car in settings["cars"]}
    return Job(name, path, {**train, "out": str(path / "train")}, races)
