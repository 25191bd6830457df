"""A training session: its run folder, its examinations, the best policy so far, and what a user sees of it."""

import json
import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd
import torch
from stable_baselines3.common.logger import KVWriter, Logger, TensorBoardOutputFormat
from torch import Tensor, nn

from racerl.assemble import build_race, build_races, files_read, one_world_each, unlimited
from racerl.control.policy import AnyPolicy, create_policy, save_policy
from racerl.documents import MAX_TEXT_BYTES, read_text, write_text
from racerl.env.black_box import read_failures, write_failures
from racerl.env.observations import settings_of
from racerl.env.race import Race
from racerl.env.races import Races
from racerl.env.termination import Crash, Termination
from racerl.errors import ConfigError, Diverged, DocumentError, RunError
from racerl.evaluate.drive import drive
from racerl.evaluate.laps import score
from racerl.interruption import held_back
from racerl.run import RunFolder
from racerl.track.folder import OTHERS
from racerl.train.trackers import Tracker

PROGRESS = "progress.jsonl"
CHECKPOINT_PERIOD = 30.0  # s
EVALUATION_CARS, EVALUATION_LAPS = 16, 2  # cars of the training's own randomization
EVALUATION_FEWEST = 4  # cars on each of several tracks
EVALUATION_SEED = 1_000_003
CLEAN = 0.9  # share of the laps that stay on the track, before pace counts
TOLERATED = 0.0005  # m s of E_off per lap that a faster policy may have: a quarter of what the paper's has on its car


@dataclass(frozen=True)
class Progress:
    """What a user wants to see while it trains."""

    steps: int
    total_steps: int
    seconds: float
    steps_per_s: float
    reward: float  # mean per step of the last rollout
    evaluation: Mapping[str, Any]  # of the current policy, empty before the first
    stage: str = "train"  # or "refine"; steps are counted from its beginning


class JsonLines(KVWriter):
    """Appends each record of the logger as one line of JSON."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def write(self, key_values: dict[str, Any], key_excluded: dict[str, tuple[str, ...]], step: int = 0) -> None:
        """Append the finite numbers among the values."""
        numbers = {key: float(value) for key, value in sorted(key_values.items())}
        record = {"steps": step} | {key: value for key, value in numbers.items() if math.isfinite(value)}
        with self.path.open("a", encoding="utf-8") as stream:
            stream.write(json.dumps(record) + "\n")

    def rewind(self, steps: int) -> None:
        """Take back the lines after so many steps, which a killed run wrote behind its checkpoint."""
        if self.path.is_file():
            write_text(self.path, _until(self.path, steps))

    def close(self) -> None:
        """Nothing is kept open."""


def copy_progress(run: Path, other: Path, steps: int) -> None:
    """Put what a training logged up to so many steps into another run's folder."""
    write_text(other / PROGRESS, _until(run / PROGRESS, steps))


def _until(path: Path, steps: int) -> str:
    lines = read_text(path, 16 * MAX_TEXT_BYTES).splitlines()
    return "".join(f"{line}\n" for line in lines if _steps(line) <= steps)


def _steps(line: str) -> float:
    """Return the steps of a line, infinity for one that is torn."""
    try:
        return float(json.loads(line)["steps"])
    except (ValueError, KeyError, TypeError, RecursionError):
        return math.inf


class Examiner:
    """Races a policy against the clock, always from the same starts, in cars of the training's randomization."""

    def __init__(self, settings: Mapping[str, Any], device: torch.device) -> None:
        worlds = one_world_each(unlimited(settings))
        cars = max(EVALUATION_CARS // len(worlds), EVALUATION_FEWEST)
        self.seeds = [EVALUATION_SEED + i for i in range(cars)]
        self.races = [
            build_race(world, cars=cars, seeds=self.seeds, device=device, termination=Crash()) for world in worlds
        ]

    def examine(self, policy: AnyPolicy) -> dict[str, Any]:
        """Return the score of two flying laps of each car, of those on all tracks together."""
        laps = []
        for race in self.races:
            race.reseed(self.seeds)
            race.reset()
            laps += drive(race, policy, EVALUATION_LAPS)
        return score(laps)


def rank(result: Mapping[str, Any]) -> tuple[bool, float, bool, bool, float]:
    """Return a key that is smaller for a better result: laps at all, few crashes, hardly off the track, faster laps."""
    unclean = result["valid_laps"] < CLEAN * result["laps"]
    wide, lap = result["e_off"] > TOLERATED, result["settled_lap_s"] or math.inf
    return not result["laps"], result["crash_share"], unclean, wide, lap


class Session:
    """What every algorithm trains in; the folder is started once the algorithm knows that it can."""

    def __init__(
        self,
        settings: Mapping[str, Any],
        out: Path,
        device: torch.device,
        on_progress: Callable[[Progress], None],
        tracker: Tracker | None = None,
    ) -> None:
        self.settings, self.out, self.device, self.on_progress = settings, out, device, on_progress
        self.tracker = tracker
        self.seed: int = settings["seed"]
        self.examiner = Examiner(settings, device)
        self.races: list[Race] = [*self.examiner.races]  # all that is driven in
        self.failures: list[pd.DataFrame] = []  # of cars, before the run was resumed
        self.best: dict[str, Any] | None = None
        self.last: dict[str, Any] = {}
        self.earlier_seconds = 0.0  # of the run before it was resumed
        self._began = time.perf_counter()

    def start(self) -> None:
        """Create the run folder, or continue in it; the clock starts."""
        facts = {"seed": self.seed, "threads": self.settings["threads"], "device": str(self.device)}
        facts["files"] = files_read(self.settings)
        self.folder = RunFolder.start(self.out, "train", self.settings, **facts)
        began = self.folder.manifest.get("files") or {}
        if changed := [name for name, content in facts["files"].items() if began.get(name, content) != content]:
            raise RunError(
                f"out = {self.out}: {changed[0]} has changed since this training began; put it back, or choose "
                "another out="
            )
        self.failures = read_failures(self.folder.path)
        tensorboard = TensorBoardOutputFormat(str(self.folder.path / "tensorboard"))
        self.lines = JsonLines(self.folder.path / PROGRESS)
        tracked = [self.tracker.follow(self.folder)] if self.tracker else []
        self.logger = Logger(None, [tensorboard, self.lines, *tracked])
        self._began = time.perf_counter()

    @contextmanager
    def kept(self, keep: Callable[[], None]) -> Iterator[Callable[[], None]]:
        """Yield what a loop calls between two steps: it keeps what is done from time to time, and when asked to stop.

        What asks to stop is held back until then.
        """
        saved = time.perf_counter()
        with held_back() as asked:

            def between() -> None:
                nonlocal saved
                if asked or time.perf_counter() - saved > CHECKPOINT_PERIOD:
                    keep()
                    self.keep_failures()
                    saved = time.perf_counter()
                asked.release()

            yield between

    def keep_failures(self) -> None:
        """Write what led to the failures of cars so far, if any failed."""
        write_failures(self.folder.path, self.races, self.failures)

    def facts(self) -> dict[str, Any]:
        """Return what a checkpoint keeps of the session; what was recorded since the last line of the log, too."""
        pending = {key: float(value) for key, value in self.logger.name_to_value.items()}
        return {"best": self.best, "last": self.last, "seconds": self.seconds, "pending": pending}

    def recall(self, state: Mapping[str, Any] | None, steps: int) -> None:
        """Go on from a checkpoint's state after so many steps, or without one; what was logged behind is taken back."""
        self.lines.rewind(steps)
        if state is None:
            return
        known = state["session"]
        self.best, self.last, self.earlier_seconds = known["best"], known["last"], known["seconds"]
        for key, value in known["pending"].items():
            self.logger.record(key, value)

    def build_race(self, cars: int, settings: Mapping[str, Any] | None = None) -> Race:
        """Return a race of the training's one track, with its seed, or of the settings given.

        Raises ConfigError for several tracks.
        """
        if self.settings["track"].get(OTHERS):
            name = self.settings["algo"]["name"]
            raise ConfigError(f"algo={name} learns on one track, several are given; use algo=ppo, or give one")
        race = build_race(settings or self.settings, cars=cars, seeds=[self.seed], device=self.device)
        self.races.append(race)
        return race

    def build_races(
        self,
        cars: int,
        settings: Mapping[str, Any] | None = None,
        times: int = 1,
        termination: Termination | None = None,
    ) -> Race | Races:
        """Return a race of all tracks, its cars `times` over, of the training's world or of the settings given."""
        race = build_races(
            settings or self.settings,
            cars=cars,
            seed=self.seed,
            device=self.device,
            times=times,
            termination=termination,
        )
        self.races += race.races if isinstance(race, Races) else [race]
        return race

    @property
    def seconds(self) -> float:
        """Training time in s, earlier sessions included, evaluations too."""
        return self.earlier_seconds + time.perf_counter() - self._began

    def examine(self, policy: AnyPolicy, steps: int, *, improving: bool = False) -> None:
        """Evaluate a policy and keep it when it is the best so far by `rank`, or anyhow where they are `improving`."""
        self.last = {**self.examiner.examine(policy), "steps": steps}
        self.logger.record("time/seconds", self.seconds)
        for name, value in self.last.items():
            if isinstance(value, (int, float)):
                self.logger.record(f"evaluation/{name}", value)
        if improving or self.best is None or rank(self.last) <= rank(self.best):
            self.best = self.last
            save_policy(policy, self.folder.path, evaluation=self.best)


def require_finite_weights(networks: Mapping[str, Iterable[Tensor]], steps: int, remedy: str) -> None:
    """Raise Diverged where a network's weights are not finite after so many control steps."""
    for name, weights in networks.items():
        if not all(bool(weight.isfinite().all()) for weight in weights):
            raise Diverged(f"diverged after {steps:,} control steps: the {name}'s weights are not finite; {remedy}")


def read_progress(run: Path) -> pd.DataFrame:
    """Return what a training logged, a row for every step; of a number that was written twice, the last counts.

    Raises RunError for a file that is missing or damaged.
    """
    path = run / PROGRESS
    try:
        lines = [json.loads(line) for line in read_text(path, 16 * MAX_TEXT_BYTES).splitlines() if line.strip()]
        table = pd.DataFrame(lines).apply(pd.to_numeric)
        return table.groupby("steps", as_index=False).last()  # of each number that stands in several lines
    except (DocumentError, ValueError, KeyError, TypeError, OverflowError, RecursionError) as error:
        raise RunError(f"{path}: cannot be read ({' '.join(str(error).split())}); train again") from error


def policy_of(network: nn.Module, race: Race | Races, settings: Mapping[str, Any]) -> AnyPolicy:
    """Return a network as a policy for the race it learns in, sharing its weights."""
    return create_policy(network, settings_of(settings["obs"]["name"], race.observation), settings["action"])
