"""A policy's call for one observation, as a car makes it 20 times a second: microseconds, median and 99th percentile.

Measured in turns on one thread, for the actor of each budget: on board (numpy), the batch policy (torch), and
Stable-Baselines3's `predict`.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from racerl.assemble import build_race, use_threads
from racerl.bench import Compose, Progress
from racerl.control.onboard import OnboardPolicy
from racerl.control.policy import Policy as Feedforward
from racerl.errors import ConfigError
from racerl.train.ppo import Budget, RacePPO, actor_of
from racerl.train.session import policy_of

BLOCK = 100  # calls of one kind before the next kind's turn


@dataclass(frozen=True)
class Policy:
    """Actors of these `budgets`, `calls` calls each."""

    budgets: tuple[str, ...]
    calls: int

    def __post_init__(self) -> None:
        if self.calls < 1 or not self.budgets:
            raise ConfigError("benchmark: calls ≥ 1 and at least one budget are allowed")

    def measure(self, compose: Compose, threads: int, on_progress: Progress) -> dict[str, Any]:
        """Return microseconds per call by budget and way of calling."""
        use_threads(1)
        results = {}
        for i, budget in enumerate(self.budgets):
            on_progress(i / len(self.budgets), f"{budget} budget")
            results[budget] = self._measure(compose("train", [f"budget={budget}"]))
        use_threads(threads)
        return {"policy_call_us": results}

    def _measure(self, settings: dict[str, Any]) -> dict[str, Any]:
        race = build_race(settings, cars=1, seeds=[0])
        budget = Budget.of({**settings["budget"], "cars": 1})
        model = RacePPO(race, budget, seed=0)
        policy = cast(Feedforward, policy_of(actor_of(model), race, settings))
        onboard = OnboardPolicy(policy)
        observation = race.observe()
        single = observation[0].numpy()
        ways: dict[str, Callable[[], Any]] = {
            "onboard": lambda: onboard(single),
            "torch": lambda: policy(observation),
            "sb3_predict": lambda: model.predict(single, deterministic=True),
        }
        times = {name: np.empty(self.calls) for name in ways}
        for first in range(-BLOCK, self.calls, BLOCK):  # the first block warms up
            for name, call in ways.items():
                for k in range(first, min(first + BLOCK, self.calls)):
                    began = time.perf_counter_ns()
                    call()
                    times[name][max(k, 0)] = time.perf_counter_ns() - began
        us = {name: _percentiles(values) for name, values in times.items()}
        ratio = us["torch"]["median"] / us["onboard"]["median"]
        apart = float(np.abs(onboard(single) - policy(observation)[0].numpy()).max())
        return {"layers": policy.sizes, **us, "ratio_torch_to_onboard": ratio, "largest_difference": apart}


def _percentiles(nanoseconds: np.ndarray) -> dict[str, float]:
    median, p99 = np.percentile(nanoseconds, [50, 99]) / 1e3
    return {"median": float(median), "p99": float(p99)}
