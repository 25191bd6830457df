"""Identification of a recorded drive: seconds, and the ratio to plain AdamW on torch, as the paper did it.

All methods minimise the command's objective over the same three quarters of the runs from the same start, and are
scored on the last quarter. AdamW's passes are counted with the
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
from numpy.typing import NDArray

from racerl.bench import Compose, Progress
from racerl.data.log import Log
from racerl.estimation.unknowns import choose_unknowns
from racerl.identify.folds import deal
from racerl.identify.identify import identify
from racerl.identify.methods import Fit
from racerl.identify.methods.adamw import Adamw, torch_gradient
from racerl.identify.methods.gauss_newton import GaussNewton
from racerl.identify.objective import Objective
from racerl.identify.scored import Scored
from racerl.identify.task import Task, make_task
from racerl.identify.windows import choose_wiring
from racerl.record.record import Plan, encode, table
from racerl.vehicle.load import load_vehicle
from racerl.vehicle.rollout import Rollout

CLOSE = 1.01  # of Gauss–Newton's cost, at which AdamW counts as arrived


@dataclass(frozen=True)
class Identify:
    """`seconds` of a hidden car's excitation programme; AdamW gets at most `passes` at `rate`; `shorter` logs too."""

    seconds: float
    passes: int
    rate: float
    shorter: tuple[float, ...] = ()  # s, of further logs that the command is timed on

    def measure(self, compose: Compose, threads: int, on_progress: Progress) -> dict[str, Any]:
        """Return seconds, passes and ratios."""
        settings = {**compose("identify", ["logs=drive.parquet", "vehicle=published"]), "threads": threads}
        growth = []
        for length in (*self.shorter, self.seconds):
            on_progress(0.05, f"the whole command on {length:g} s")
            drive = _record(compose, length)
            log = Log.from_table("drive", drive.drop(columns="manoeuvre"))
            whole = _whole_command(drive, settings)
            task, scored = _prepare(log, settings)
            objective, unseen = _objective(task, scored, settings)
            newton_seconds, newton = _timed(_gauss_newton, objective)
            growth.append(
                {
                    "log_seconds": log.seconds,
                    "command_seconds": whole["seconds"],
                    "gauss_newton_seconds": newton_seconds,
                }
            )

        def held_out(fit: Fit) -> dict[str, float | None]:
            return scored.errors(fit.point.theta, unseen).rmse()[str(settings["window"])]

        on_progress(0.35, "one pass on torch")
        start = objective.start(objective.unknowns.start)
        torch_pass, gradient = _median(lambda: torch_gradient(objective, start))
        kernel_pass, at = _median(lambda: objective.linearise(start))
        disagreement = float(np.abs(gradient - at.t.sum(axis=0)).max() / np.abs(gradient).max())
        on_progress(0.45, "AdamW")
        adamw_seconds, passes, adamw = self._adamw(objective, newton)
        reached = adamw.linearised.cost <= CLOSE * newton.linearised.cost
        return {
            "log_seconds": log.seconds,
            "windows": objective.windows.count,
            "parameters": len(objective.unknowns.names),
            "command": whole,
            "growth": growth,
            "gauss_newton": {
                "seconds": newton_seconds,
                "steps": newton.steps,
                "cost": newton.linearised.cost,
                "rmse_held_out": held_out(newton),
            },
            "adamw": {
                "seconds": adamw_seconds,
                "passes": passes,
                "cost": adamw.linearised.cost,
                "rmse_held_out": held_out(adamw),
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


def _record(compose: Compose, seconds: float) -> pd.DataFrame:
    """Return so much driving of a hidden car."""
    record = compose("record", ["vehicle=published", "hidden.spread=0.2", f"seconds={seconds}"])
    return table(Plan.of(record).drive(), **record["smoothing"])


def _objective(task: Task, scored: Scored, settings: Mapping[str, Any]) -> tuple[Objective, NDArray[np.int64]]:
    """Return the command's objective over the first fold's windows, and the windows it has not seen."""
    fold = deal(scored.cut, settings["folds"])[0][0]
    seen, unseen = np.flatnonzero(fold.seen(task.cut)), np.flatnonzero(fold.unseen(scored.cut))
    first = task.objective(seen, 1.0, 0.0)
    data = first.linearise(first.start(task.unknowns.start)).data
    return task.objective(seen, float(len(seen) * len(task.weight)), data), unseen


def _gauss_newton(objective: Objective) -> Fit:
    return GaussNewton().fit(objective, objective.start(objective.unknowns.start), _quiet)


def _whole_command(drive: pd.DataFrame, settings: Mapping[str, Any]) -> dict[str, float]:
    """Return the seconds of `racerl identify` with all its starts and held-out runs."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.parquet"
        path.write_bytes(encode(drive, path.name))
        given = {**settings, "logs": [str(path)]}
        seconds, _ = _timed(lambda: identify(given, Path(folder) / "out"))
    return {"seconds": seconds, "starts": settings["starts"], "folds": settings["folds"]}


def _prepare(log: Log, settings: Mapping[str, Any]) -> tuple[Task, Scored]:
    """Return the command's own task and scoring for a log."""
    vehicle = load_vehicle(settings["vehicle"])
    wiring = choose_wiring([log], settings["inputs"])
    unknowns = choose_unknowns(wiring.driven(vehicle), settings["priors"], settings["hold"], vehicle)
    rollout = Rollout(wiring.driven(vehicle), unknowns.names, wiring.observed, settings["step"])
    return make_task(settings, rollout, unknowns, wiring, [log]), Scored(rollout, wiring, [log], settings)


def _timed(call: Any, *arguments: Any) -> tuple[float, Any]:
    began = time.perf_counter()
    result = call(*arguments)
    return time.perf_counter() - began, result


def _median(call: Any, repeats: int = 5) -> tuple[float, Any]:
    """Return the median seconds of several calls, and what the last one returned."""
    timed = [_timed(call) for _ in range(repeats)]
    return float(np.median([seconds for seconds, _ in timed])), timed[-1][1]


def _quiet(iteration: int, cost: float) -> None:
    pass
