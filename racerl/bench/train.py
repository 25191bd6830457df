"""Training against stock Stable-Baselines3 PPO on the same environment: throughput, memory, and time to a fast lap.

Throughput and memory: same networks, hyperparameters and threads, in turns; ours in bf16 where the budget says so. Time
to a lap: `fast` trains to its end for every seed and is then scored; the stock PPO, with the hyperparameters of the
paper, is scored every so often until it arrives or its `patience` ends. A policy has arrived when its mean of 20 clean
laps on the model without randomization is within `margin` of the time-optimal lap. Scoring does not count.
"""

import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback

from racerl.assemble import build_race, unlimited
from racerl.bench import Compose, Progress
from racerl.control import Controller
from racerl.control.policy import load_policy
from racerl.env.adapters.sb3 import RaceVecEnv
from racerl.env.race import Race
from racerl.env.termination import Crash
from racerl.errors import ConfigError
from racerl.evaluate.drive import drive
from racerl.evaluate.laps import score
from racerl.optimum.optimum import find_optimum
from racerl.train.ppo import Budget, RacePPO, actor_of, hyperparameters
from racerl.train.session import policy_of
from racerl.train.train import train

LAPS = 20
# a command of racerl that ends by printing its largest resident memory in kB; what is known of a child in its parent
# counts the parent's, too
PEAK = r"""
import re
from pathlib import Path
from racerl.cli import main
try:
    main()
finally:
    print(re.search(r"VmHWM:\s*(\d+)", Path("/proc/self/status").read_text())[1])
"""


@dataclass(frozen=True)
class Train:
    """Throughput for these `budgets` over `seconds` each; time to a lap for the overrides `fast` and these `seeds`."""

    budgets: tuple[str, ...]
    seconds: float
    short: tuple[str, ...]  # how to train briefly, all stages: its memory is measured
    fast: tuple[str, ...]
    seeds: tuple[int, ...]
    margin: float
    patience: float  # s
    period: float  # s between scorings of the stock PPO

    def __post_init__(self) -> None:
        if not (self.seconds > 0 and self.margin > 0 and self.period > 0 and self.patience >= 0):
            raise ConfigError("benchmark: seconds, margin and period > 0 and patience ≥ 0 are allowed")

    def measure(self, compose: Compose, threads: int, on_progress: Progress) -> dict[str, Any]:
        """Return steps per second, MB and seconds, with the ratios to the stock PPO."""
        common = ["+dr=friction_0.02", f"threads={threads}"]
        throughput = {}
        for i, budget in enumerate(self.budgets):
            on_progress(0.4 * i / len(self.budgets), f"throughput, {budget} budget")
            throughput[budget] = self._throughput(compose("train", [*common, f"budget={budget}"]))
        on_progress(0.4, "memory")
        facts: dict[str, Any] = {"throughput": throughput, "peak_memory_mb": self._memory(common)}
        if self.seeds:
            facts["time_to_lap"] = self._time_to_lap(compose, common, on_progress)
        return facts

    def _throughput(self, settings: dict[str, Any]) -> dict[str, float]:
        """Return control steps per second of whole updates, rollout and learning."""
        budget = Budget.of({**settings["budget"], "target_kl": None})
        races = [build_race(settings, cars=budget.cars, seeds=[0]) for _ in range(2)]
        learners = [RacePPO(races[0], budget, seed=0), stock_ppo(races[1], budget, seed=0)]
        spent, steps = [0.0, 0.0], budget.cars * budget.rollout
        for learner in learners:
            learner.learn(1)  # the first update warms up
        turns = 0
        while sum(spent) < self.seconds:
            turns += 1
            for i, learner in enumerate(learners):
                began = time.perf_counter()
                learner.learn(1, reset_num_timesteps=False)
                spent[i] += time.perf_counter() - began
        ours, stock = (turns * steps / seconds for seconds in spent)
        return {"steps_per_s": ours, "stock_steps_per_s": stock, "ratio": ours / stock}

    def _memory(self, words: Sequence[str]) -> float:
        """Return the largest resident memory of a training in its own process, in MB."""
        with tempfile.TemporaryDirectory() as folder:
            given = [*words, *self.short, f"out={folder}/train"]
            done = subprocess.run(  # noqa: S603 (our own command)
                [sys.executable, "-c", PEAK, "train", *given], check=True, capture_output=True, text=True
            )
        return float(done.stdout.rsplit(maxsplit=1)[-1]) / 1024

    def _time_to_lap(self, compose: Compose, common: Sequence[str], on_progress: Progress) -> dict[str, Any]:
        judge = Judge(compose("train", common))
        runs = []
        for i, seed in enumerate(self.seeds):
            on_progress(0.45 + 0.2 * i / len(self.seeds), f"{' '.join(self.fast)}, seed {seed}")
            settings = compose("train", [*common, *self.fast, f"seed={seed}"])
            with tempfile.TemporaryDirectory() as folder:
                facts = train(settings, Path(folder) / "train")
                runs.append({"seed": seed, "seconds": facts["seconds"], **judge(load_policy(Path(folder) / "train"))})
        on_progress(0.65, "stock PPO with the paper's hyperparameters")
        stock = self._stock_runs(compose("train", [*common, "budget=paper", f"seed={self.seeds[0]}"]), judge)
        median = float(np.median([run["seconds"] for run in runs]))
        arrived = _arrived(stock[-1], self.margin)
        return {
            "margin": self.margin,
            "optimum_s": judge.optimum,
            "method": list(self.fast),
            "runs": runs,
            "arrived": sum(_arrived(run, self.margin) for run in runs),
            "median_seconds": median,
            "stock": stock,
            "stock_arrived": arrived,
            "ratio" if arrived else "ratio_at_least": stock[-1]["seconds"] / median,
        }

    def _stock_runs(self, settings: dict[str, Any], judge: "Judge") -> list[dict[str, Any]]:
        budget = Budget.of(settings["budget"])
        race = build_race(settings, cars=budget.cars, seeds=[settings["seed"]])
        watch = Watch(self, settings, race, judge)
        stock_ppo(race, budget, settings["seed"]).learn(budget.steps, callback=watch)
        return watch.scores


class Judge:
    """Scores policies on the model without randomization."""

    def __init__(self, settings: dict[str, Any]) -> None:
        exact = unlimited({**settings, "dr": {**settings["dr"], "sigma": 0.0}})
        self.race = build_race(exact, cars=1, seeds=[0], termination=Crash())
        self.optimum = find_optimum(self.race.vehicle, self.race.track, self.race.action).time

    def __call__(self, policy: Controller) -> dict[str, Any]:
        """Return the mean of 20 laps in s, how many were clean, and the share over the optimum."""
        self.race.reseed([0])
        self.race.reset()
        result = score(drive(self.race, policy, LAPS))
        mean = result["mean_lap_s"]
        over = None if mean is None else mean / self.optimum - 1.0
        return {"mean_lap_s": mean, "valid_laps": result["valid_laps"], "over_optimum": over}


class Watch(BaseCallback):
    """Scores a stock PPO after every update that ends a period, until it has arrived or patience ends."""

    def __init__(self, benchmark: Train, settings: dict[str, Any], race: Race, judge: Judge) -> None:
        super().__init__()
        self.benchmark, self.settings, self.race, self.judge = benchmark, settings, race, judge
        self.scores: list[dict[str, Any]] = []

    def _on_training_start(self) -> None:
        self._began, self._scoring, self._over = time.perf_counter(), 0.0, False

    def _on_step(self) -> bool:
        return not self._over

    def _on_rollout_start(self) -> None:
        began = time.perf_counter()
        seconds = began - self._began - self._scoring
        if seconds < (len(self.scores) + 1) * self.benchmark.period and seconds < self.benchmark.patience:
            return
        policy = policy_of(actor_of(self.model), self.race, self.settings)  # type: ignore[arg-type]
        self.scores.append({"seconds": seconds, "steps": self.num_timesteps, **self.judge(policy)})
        self._over = seconds >= self.benchmark.patience or _arrived(self.scores[-1], self.benchmark.margin)
        self._scoring += time.perf_counter() - began


def stock_ppo(race: Race, budget: Budget, seed: int) -> PPO:
    """Return Stable-Baselines3's own PPO for a race."""
    return PPO(env=RaceVecEnv(race), batch_size=budget.batch, seed=seed, device=race.device, **hyperparameters(budget))


def _arrived(score: Mapping[str, Any], margin: float) -> bool:
    return score["valid_laps"] == LAPS and score["over_optimum"] is not None and score["over_optimum"] <= margin
