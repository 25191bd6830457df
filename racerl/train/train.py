"""The train stage: PPO on the configured race, evaluated on the way, the best policy kept.

Writes into its run folder: `policy.safetensors` and `policy.json` (the best policy by evaluation), `progress.jsonl`
(one line per update, append-only), `tensorboard/`, and while it runs `checkpoint.safetensors`. An interrupted run
continues from its checkpoint, bit for bit, when it is started again with the same settings.
"""

import json
import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import KVWriter, Logger, TensorBoardOutputFormat
from torch import nn

from racerl.assemble import build_race, check_settings, choose_device, use_threads
from racerl.control.policy import Policy, save_policy
from racerl.env.termination import Crash
from racerl.errors import ConfigError
from racerl.evaluate.drive import drive
from racerl.evaluate.laps import score
from racerl.registry import construct
from racerl.run import RunFolder
from racerl.train.checkpoint import FILE as CHECKPOINT
from racerl.train.checkpoint import load_checkpoint, save_checkpoint
from racerl.train.ppo import Budget, RacePPO

PROGRESS = "progress.jsonl"
CHECKPOINT_PERIOD = 30.0  # s
EVALUATION_CARS, EVALUATION_LAPS = 16, 1  # cars of the training's own randomization
EVALUATION_SEED = 1_000_003


@dataclass(frozen=True)
class Progress:
    """What a user wants to see while it trains."""

    steps: int
    total_steps: int
    seconds: float
    steps_per_s: float
    reward: float  # mean per step of the last rollout
    evaluation: Mapping[str, Any]  # of the current policy, empty before the first


def train(
    settings: Mapping[str, Any], out: Path, on_progress: Callable[[Progress], None] = lambda progress: None
) -> dict[str, Any]:
    """Train a policy into the run folder `out`; return the facts that the manifest keeps."""
    seed, threads = settings["seed"], settings["threads"]
    if not isinstance(seed, int) or not 0 <= seed < 2**31:
        raise ConfigError(f"seed = {seed}: allowed is a whole number, 0 … 2³¹ − 1")
    check_settings(settings)
    budget = construct(Budget, settings["budget"], "budget")
    device = choose_device(settings["device"])
    use_threads(threads)
    race = build_race(settings, cars=budget.cars, seeds=[seed], device=device)
    examiner = Examiner(settings, device)

    folder = RunFolder.start(out, "train", settings, seed=seed, threads=threads, device=str(device))
    model = RacePPO(race, budget, seed)
    tensorboard = TensorBoardOutputFormat(str(folder.path / "tensorboard"))
    model.set_logger(Logger(None, [tensorboard, JsonLines(folder.path / PROGRESS)]))
    trainer = Trainer(folder, examiner, settings, on_progress)
    model.learn(budget.steps, callback=trainer)
    trainer.examine()
    (folder.path / CHECKPOINT).unlink(missing_ok=True)
    facts = {
        "steps": model.num_timesteps,
        "seconds": round(trainer.seconds, 1),
        "nan_cars": race.faults,
        "best": trainer.best,
    }
    folder.finish(**facts)
    return facts


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

    def close(self) -> None:
        """Nothing is kept open."""


class Examiner:
    """Races a policy against the clock, always from the same starts, in cars of the training's randomization."""

    def __init__(self, settings: Mapping[str, Any], device: torch.device) -> None:
        unlimited = {**settings, "sim": {**settings["sim"], "max_steps": 2**31}}
        self.seeds = [EVALUATION_SEED + i for i in range(EVALUATION_CARS)]
        self.race = build_race(unlimited, cars=EVALUATION_CARS, seeds=self.seeds, device=device, termination=Crash())

    def examine(self, policy: Policy) -> dict[str, Any]:
        """Return the score of a flying lap of each car."""
        self.race.reseed(self.seeds)
        self.race.reset()
        return score(drive(self.race, policy, EVALUATION_LAPS))


def rank(result: Mapping[str, Any]) -> tuple[float, float, float]:
    """Return a key that is smaller for a better result: fewer crashes, more valid laps, then faster."""
    return result["crash_share"], -result["valid_laps"], result["mean_lap_s"] or math.inf


class Trainer(BaseCallback):
    """Evaluates, keeps the best policy, writes checkpoints and reports, always at the start of a rollout."""

    def __init__(
        self,
        folder: RunFolder,
        examiner: Examiner,
        settings: Mapping[str, Any],
        on_progress: Callable[[Progress], None],
    ) -> None:
        super().__init__()
        self.folder, self.examiner, self.settings, self.on_progress = folder, examiner, settings, on_progress
        self.best: dict[str, Any] | None = None
        self.last: dict[str, Any] = {}
        self.examined = 0  # evaluations so far
        self._earlier_seconds = 0.0  # of the run before it was resumed

    model: RacePPO

    @property
    def seconds(self) -> float:
        """Training time in s, earlier sessions included, evaluations too."""
        return self._earlier_seconds + time.perf_counter() - self._began

    def _on_training_start(self) -> None:
        if (self.folder.path / CHECKPOINT).is_file():
            facts = load_checkpoint(self.model, self.folder.path)
            self.best, self.last = facts["best"], facts["last"]
            self.examined, self._earlier_seconds = facts["examined"], facts["seconds"]
        self._began = self._saved = time.perf_counter()
        self._first_step = self.model.num_timesteps

    def _on_step(self) -> bool:
        return True

    def _on_rollout_start(self) -> None:
        budget = self.model.budget
        if self.model.num_timesteps >= (self.examined + 1) * budget.steps / budget.evaluations:
            self.examine()
            self.examined += 1
        if time.perf_counter() - self._saved > CHECKPOINT_PERIOD:
            self.save()
        elapsed = time.perf_counter() - self._began
        self.on_progress(
            Progress(
                steps=self.model.num_timesteps,
                total_steps=budget.steps,
                seconds=self.seconds,
                steps_per_s=(self.model.num_timesteps - self._first_step) / max(elapsed, 1e-9),
                reward=float(self.model.rollout.rewards.mean()),
                evaluation=self.last,
            )
        )

    def save(self) -> None:
        """Write a checkpoint."""
        facts = {"best": self.best, "last": self.last, "examined": self.examined, "seconds": self.seconds}
        save_checkpoint(self.model, self.folder.path, facts)
        self._saved = time.perf_counter()

    def examine(self) -> None:
        """Evaluate the current policy and keep it when it is the best so far."""
        policy = extract_policy(self.model, self.settings)
        self.last = {**self.examiner.examine(policy), "steps": self.model.num_timesteps}
        for key, value in self.last.items():
            if isinstance(value, (int, float)):
                self.logger.record(f"evaluation/{key}", value)
        if self.best is None or rank(self.last) <= rank(self.best):
            self.best = self.last
            save_policy(policy, self.folder.path, evaluation=self.best)


def extract_policy(model: RacePPO, settings: Mapping[str, Any]) -> Policy:
    """Return the actor of a model, sharing its weights."""
    network = nn.Sequential(*model.policy.mlp_extractor.policy_net, model.policy.action_net)
    observation = {"name": settings["obs"]["name"], **vars(model.race.observation)}
    return Policy(network, observation, settings["action"])
