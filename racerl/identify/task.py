"""What a fit is made of, and how it is carried out: several starts, then the prior's strength set by what is left."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from racerl import registry
from racerl.data.log import CHANNELS, Log
from racerl.errors import ConfigError, suggest
from racerl.identify import methods as methods_package
from racerl.identify.methods import Fit, Method
from racerl.identify.objective import Objective, independent_residuals
from racerl.identify.unknowns import Unknowns
from racerl.identify.windows import Cut, Wiring, channel_scale, cut
from racerl.vehicle.rollout import Rollout

Array = NDArray[np.float64]
ROUNDS = 2  # fits between which the prior's strength is set by the residuals that are left
MOST_WINDOWS = 3000  # of a fit: long logs are cut with less overlap, very long ones with gaps
START_SPREAD = 0.7  # of the priors' deviations, of the further starts


@dataclass(frozen=True)
class Task:
    """What a fit is made of: the rollout, its unknowns, the windows and how their errors count."""

    rollout: Rollout
    unknowns: Unknowns
    cut: Cut
    scale: Array
    weight: Array
    overlap: float
    method: Method
    threads: int

    def objective(self, index: NDArray[np.int64], independent: float, data: float) -> Objective:
        """Return F over some windows, with the prior as strong as `independent` residuals of mean square `data` ask."""
        windows = self.cut.windows.take(index)
        penalty = data / independent
        return Objective(self.rollout, self.unknowns, windows, self.scale, self.weight, penalty, self.threads)


@dataclass(frozen=True)
class Solution:
    """A fit with its objective, and how many independent residuals it was made from."""

    fit: Fit
    objective: Objective
    independent: float


def make_task(
    settings: Mapping[str, Any], rollout: Rollout, unknowns: Unknowns, wiring: Wiring, logs: Sequence[Log]
) -> Task:
    """Cut the logs and choose scale, weights and method; raise LogError or ConfigError where that fails."""
    length = settings["window"]
    stride = max(sum(len(log.table) for log in logs) // MOST_WINDOWS, 1, length // 5)
    return Task(
        rollout,
        unknowns,
        cut(logs, wiring, rollout.vehicle, length, stride, settings["slowest"]),
        channel_scale(logs, wiring.observed),
        _weights(settings["weights"], wiring),
        max(1.0, (length + 1) / stride),
        registry.create(methods_package, settings["method"]),
        settings["threads"],
    )


def _weights(given: Mapping[str, Any], wiring: Wiring) -> Array:
    for channel, weight in given.items():
        if channel not in CHANNELS:
            raise ConfigError(f"weights: no channel '{channel}'{suggest(channel, CHANNELS)}")
        if isinstance(weight, bool) or not isinstance(weight, (int, float)) or not 0 <= weight < np.inf:
            raise ConfigError(f"weights.{channel} = {weight}: allowed is a number ≥ 0")
    weights = np.array([float(given.get(channel, 1.0)) for channel in wiring.observed])
    if not weights.any():
        raise ConfigError(f"weights: all of {', '.join(wiring.observed)} are 0; leave one to fit")
    return weights


def solve(
    task: Task, index: NDArray[np.int64], settings: Mapping[str, Any], on_share: Callable[[float], None]
) -> Solution:
    """Fit from several starts, then once more with the prior's strength set by what is left."""
    generator = np.random.default_rng(settings["seed"])
    starts = [task.unknowns.start]
    starts += [task.unknowns.draw(generator, START_SPREAD) for _ in range(settings["starts"] - 1)]
    total, done = len(starts) + ROUNDS, 0

    def on_step(iteration: int, cost: float) -> None:
        on_share(min(0.99, (done + 1 - 0.9**iteration) / total))

    # at first one independent residual for each window and channel is assumed
    channels = int((task.weight > 0).sum())
    objective = task.objective(index, len(index) * channels, 0.0)
    first = objective.linearise(objective.start(task.unknowns.start))
    objective = task.objective(index, len(index) * channels, first.data)
    best: Fit | None = None
    for theta in starts:
        fit = task.method.fit(objective, objective.start(theta), on_step)
        if best is None or fit.linearised.cost < best.linearised.cost:
            best = fit
        done += 1
    assert best is not None  # noqa: S101
    for _ in range(ROUNDS):
        independent = independent_residuals(objective.residuals(best.point)[:, task.weight > 0]) / task.overlap
        objective = task.objective(index, independent, best.linearised.data)
        best = task.method.fit(objective, best.point, on_step)
        done += 1
    return Solution(best, objective, independent)
