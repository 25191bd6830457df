"""Identification of a recorded drive: seconds, and the ratio to plain AdamW on torch, as the paper did it.

All methods minimise the same objective over the same windows from the same start. AdamW's passes are counted with the
compiled gradient, which takes the same path, until its cost is within 1 % of Gauss–Newton's; what they would take on
torch is that number times one measured pass of back-propagation through time.
"""

import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from racerl.bench import Compose, Progress
from racerl.data.log import Log
from racerl.identify.identify import MOST_WINDOWS, identify
from racerl.identify.methods import Fit
from racerl.identify.methods.adamw import Adamw, torch_gradient
from racerl.identify.methods.gauss_newton import GaussNewton
from racerl.identify.objective import Objective
from racerl.identify.unknowns import choose_unknowns
from racerl.identify.windows import channel_scale, choose_layout, cut
from racerl.record.record import Plan, encode, table
from racerl.vehicle.load import load_vehicle
from racerl.vehicle.rollout import Rollout

CLOSE = 1.01  # of Gauss–Newton's cost, at which AdamW counts as arrived


@dataclass(frozen=True)
class Identify:
    """`seconds` of a hidden car's excitation programme; AdamW gets at most `passes` at `rate`."""

    seconds: float
    passes: int
    rate: float

    def measure(self, compose: Compose, threads: int, on_progress: Progress) -> dict[str, Any]:
        """Return seconds, passes and ratios."""
        on_progress(0.0, "recording the drive")
        words = ["vehicle=published", "hidden.spread=0.2", f"seconds={self.seconds}"]
        record = compose("record", words)
        settings = {**compose("identify", ["logs=drive.parquet", "vehicle=published"]), "threads": threads}
        drive = table(Plan.of(record).drive(), **record["smoothing"])
        log = Log.from_table("drive", drive.drop(columns="manoeuvre"))
        on_progress(0.1, "the whole command")
        whole = _whole_command(drive, settings)
        objective = _objective(log, settings)
        on_progress(0.3, "Gauss-Newton")
        newton_seconds, newton = _timed(
            lambda: GaussNewton().fit(objective, objective.start(objective.unknowns.start), _quiet)
        )
        on_progress(0.35, "one pass on torch")
        start = objective.start(objective.unknowns.start)
        torch_pass, gradient = _timed(lambda: torch_gradient(objective, start))
        kernel_pass, at = _timed(lambda: objective.linearise(start))
        disagreement = float(np.abs(gradient - at.t.sum(axis=0)).max() / np.abs(gradient).max())
        on_progress(0.45, "AdamW")
        adamw_seconds, passes, adamw = self._adamw(objective, newton)
        reached = adamw.linearised.cost <= CLOSE * newton.linearised.cost
        return {
            "log_seconds": log.seconds,
            "windows": objective.windows.count,
            "parameters": len(objective.unknowns.names),
            "command": whole,
            "gauss_newton": {
                "seconds": newton_seconds,
                "passes": newton.iterations,
                "cost": newton.linearised.cost,
            },
            "adamw": {
                "seconds": adamw_seconds,
                "passes": passes,
                "cost": adamw.linearised.cost,
                "within_1_percent_of_gauss_newton": bool(reached),
            },
            "torch_adamw": {"seconds_per_pass": torch_pass, "seconds": torch_pass * passes},
            "pass_ratio_torch_to_kernel": torch_pass / kernel_pass,
            "gradient_disagreement": disagreement,
            "ratio_torch_adamw_to_gauss_newton": torch_pass * passes / newton_seconds,
        }

    def _adamw(self, objective: Objective, newton: Fit) -> tuple[float, int, Fit]:
        """Return seconds, the first pass within 1 % of Gauss–Newton (all passes if none) and the fit."""
        costs: list[float] = []
        method = Adamw(self.passes, self.rate)
        start = objective.start(objective.unknowns.start)
        seconds, fit = _timed(lambda: method.fit(objective, start, lambda _, cost: costs.append(cost)))
        close = np.flatnonzero(np.array(costs) <= CLOSE * newton.linearised.cost)
        passes = int(close[0]) + 1 if len(close) else len(costs)
        return seconds * passes / max(len(costs), 1), passes, fit


def _whole_command(drive: pd.DataFrame, settings: Mapping[str, Any]) -> dict[str, float]:
    """Return the seconds of `racerl identify` with all its starts and held-out runs."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.parquet"
        path.write_bytes(encode(drive, path.name))
        given = {**settings, "logs": [str(path)]}
        seconds, _ = _timed(lambda: identify(given, Path(folder) / "out"))
    return {"seconds": seconds, "starts": settings["starts"], "folds": settings["folds"]}


def _objective(log: Log, settings: Mapping[str, Any]) -> Objective:
    vehicle = load_vehicle(settings["vehicle"])
    layout = choose_layout([log])
    unknowns = choose_unknowns(vehicle, settings["priors"], settings["hold"], vehicle)
    rollout = Rollout(vehicle, unknowns.names, layout.observed, settings["step"])
    length = settings["window"]
    stride = int(np.clip(len(log.table) // MOST_WINDOWS, max(1, length // 5), length))
    windows = cut([log], layout, vehicle, length, stride, settings["slowest"]).windows
    scale = channel_scale([log], layout.observed)
    objective = Objective(rollout, unknowns, windows, scale, np.ones(len(scale)), 0.0, settings["threads"])
    objective.penalty = objective.linearise(objective.start(unknowns.start)).data / windows.count
    return objective


def _timed(call: Any) -> tuple[float, Any]:
    began = time.perf_counter()
    result = call()
    return time.perf_counter() - began, result


def _quiet(iteration: int, cost: float) -> None:
    pass
