"""The simulator: control steps per second and thread, of the whole environment and of the dynamics alone.

Cars are driven by random actions, so that episodes end and start over as they do in training. Every figure is the best
of `repeats` measurements on one thread, taken in turns, beside the same step on plain torch. On a GPU that thread only
asks for the work, and is timed until all of it is done.
"""

import os
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch

from racerl.assemble import build_race, choose_device, use_threads
from racerl.bench import Compose, Progress
from racerl.env.race import Race
from racerl.errors import ConfigError
from racerl.vehicle.kernel import TorchMotion, choose_motion

WARM_STEPS = 40  # from a start to where episodes end at different times


@dataclass(frozen=True)
class Sim:
    """Measurements over numbers of `cars`, `seconds` each."""

    cars: tuple[int, ...]
    seconds: float
    repeats: int
    device: str

    def __post_init__(self) -> None:
        if not self.cars or any(isinstance(n, bool) or not isinstance(n, int) or n < 1 for n in self.cars):
            raise ConfigError(f"benchmark.cars = {self.cars}: allowed is a list of whole numbers, at least 1")
        if not self.seconds > 0 or self.repeats < 1:
            raise ConfigError("benchmark: seconds > 0 and repeats ≥ 1 are allowed")

    def measure(self, compose: Compose, threads: int, on_progress: Progress) -> dict[str, Any]:
        """Return steps per second and thread by number of cars."""
        settings = compose("train", ["+dr=friction_0.02"])
        use_threads(1)
        device = choose_device(self.device)
        on_progress(0.0, "building the kernels")
        built = _build_seconds(build_race(settings, cars=1, seeds=[0], device=device))
        whole, dynamics, gradient, plain = {}, {}, {}, {}
        for i, count in enumerate(self.cars):
            on_progress(i / len(self.cars), f"{count} cars")
            race = build_race(settings, cars=count, seeds=[0], device=device)
            whole[str(count)], dynamics[str(count)], gradient[str(count)], plain[str(count)] = self._rates(race)
        use_threads(threads)
        return {
            "kernel": race.motion.name,
            "kernel_build_seconds": built,
            "env_steps_per_s_per_thread": whole,
            "dynamics_steps_per_s_per_thread": dynamics,
            "gradient_steps_per_s_per_thread": gradient,
            "torch_dynamics_steps_per_s_per_thread": plain,
            "ratio_dynamics_to_torch": {n: dynamics[n] / plain[n] for n in plain},
        }

    def _rates(self, race: Race) -> list[float]:
        """Return steps per second of environment, dynamics, their gradient, and dynamics on torch."""
        generator = torch.Generator().manual_seed(0)
        actions = (torch.rand(64, race.count, 2, generator=generator) * 2.0 - 1.0).to(race.device)
        for action in actions[:WARM_STEPS]:
            race.step(action)
        inputs = [t.contiguous() for t in (race.state, race.command, race.draws.values)]
        exact = TorchMotion(race.vehicle, race.draws.names, race.timing.step, race.timing.substeps)
        leaves = [tensor.clone().requires_grad_() for tensor in inputs]
        turn = iter(range(10**12))

        def step() -> None:
            race.step(actions[next(turn) % len(actions)])

        def pull() -> None:
            torch.autograd.grad(race.motion(*leaves).sum(), leaves)

        works: list[Callable[[], Any]] = [step, lambda: race.motion(*inputs), pull, lambda: exact(*inputs)]
        best = [0.0] * len(works)
        for _ in range(self.repeats):
            for i, work in enumerate(works):
                best[i] = max(best[i], race.count / self._seconds_of(work, race.device))
        return best

    def _seconds_of(self, work: Callable[[], Any], device: torch.device) -> float:
        """Return the time of one call in s, from as many as fit into the time given."""
        work()
        _finish(device)
        calls, began = 0, time.perf_counter()
        while time.perf_counter() - began < self.seconds or not calls:
            work()
            calls += 1
        _finish(device)
        return (time.perf_counter() - began) / calls


def _finish(device: torch.device) -> None:
    """Wait until a GPU has done what it was asked for."""
    if device.type == "cuda":
        torch.cuda.synchronize(device)


def _build_seconds(race: Race) -> float:
    """Return how long the kernels take that a training builds at its first use, in s."""
    kept = os.environ.get("XDG_CACHE_HOME")
    with tempfile.TemporaryDirectory() as folder:
        os.environ["XDG_CACHE_HOME"] = folder
        try:
            began = time.perf_counter()
            choose_motion(
                race.vehicle, race.draws.names, race.timing.step, race.timing.substeps, race.device, race.dtype
            )
            return time.perf_counter() - began
        finally:
            os.environ.pop("XDG_CACHE_HOME")
            if kept is not None:
                os.environ["XDG_CACHE_HOME"] = kept
