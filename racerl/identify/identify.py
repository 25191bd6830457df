"""The identify stage: fit a vehicle to logs, say how sure the values are, and score it on runs it has not seen.

Writes `model.yaml` (the vehicle, fitted to all runs), `identification.json` (values, intervals, what is not separable,
held-out errors), and `overlay.parquet` and `tyres.parquet`, which the report draws. With `fit=false` the vehicle is
only scored: no `model.yaml`, and the errors are the given vehicle's.
"""

import io
import re
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from racerl import registry
from racerl.assemble import use_threads
from racerl.data.inspect import inspect
from racerl.data.load import load_given
from racerl.data.log import Log, separate
from racerl.documents import write_bytes, write_json
from racerl.errors import ConfigError, LogError
from racerl.identify import methods as methods_package
from racerl.identify.document import write_model
from racerl.identify.folds import deal
from racerl.identify.methods import Fit, Method
from racerl.identify.objective import Objective, independent_residuals
from racerl.identify.score import START_EVERY, ErrorSum, Table, held_errors, horizons_within, rollout_errors
from racerl.identify.tyres import slips_covered, tyre_curves
from racerl.identify.uncertainty import Uncertainty, describe, estimate
from racerl.identify.unknowns import Unknowns, choose_unknowns
from racerl.identify.windows import INPUTS, Cut, Layout, channel_scale, choose_layout, cut
from racerl.run import RunFolder
from racerl.vehicle.load import load_vehicle
from racerl.vehicle.parameter import replace_values, values
from racerl.vehicle.rollout import Rollout, fastest_rate
from racerl.vehicle.vehicle import STATE

Array = NDArray[np.float64]
RESULT, MODEL, OVERLAY, TYRES = "identification.json", "model.yaml", "overlay.parquet", "tyres.parquet"
ROUNDS = 2  # fits between which the prior's strength is set by the residuals that are left
MOST_WINDOWS = 3000  # of a fit; a longer log is cut with less overlap, down to none
START_SPREAD = 0.7  # of the priors' deviations, of the further starts
OVERLAY_ROLLOUTS = 6
MOST_SCORED = 5000  # rollouts
DRAWS = 200  # of the parameters, for the tyre curves' band
STABLE = 2.5  # largest step × rate
FAR = 3.0  # deviations of its prior, beyond which a value is worth a remark


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


Progress = Callable[[str, float], None]


def identify(
    settings: Mapping[str, Any], out: Path, on_progress: Progress = lambda what, share: None
) -> dict[str, Any]:
    """Identify the vehicle of `settings` from its logs; return what was written to identification.json.

    Raises LogError for logs that can't be fitted and ConfigError for settings out of range.
    """
    _check(settings)
    use_threads(settings["threads"])
    began = time.perf_counter()
    configured = load_vehicle(settings["vehicle"])
    logs, warnings = separate(load_given(settings))
    for log in logs:
        warnings += [f"{log.name}: {warning}" for warning in inspect(log, float(configured.wheelbase))["warnings"]]
    layout = choose_layout(logs, settings["inputs"])
    vehicle = layout.driven(configured)
    unknowns = choose_unknowns(vehicle, settings["priors"], settings["hold"], configured) if settings["fit"] else None
    rollout = Rollout(vehicle, unknowns.names if unknowns else (), layout.observed, settings["step"])
    # all that can be refused is refused before anything is written
    scored = Scored(rollout, layout, logs, settings)
    task = _task(settings, rollout, unknowns, layout, logs) if unknowns else None
    folder = RunFolder.start(out, "identify", settings, seed=settings["seed"], threads=settings["threads"])
    start, everything = rollout.nominal(), np.arange(scored.cut.windows.count)
    facts: dict[str, Any] = {
        "fitted": task is not None,
        "logs": [_log_facts(log) for log in logs],
        "inputs": {"steering": layout.steering, "drive": layout.drive},
        "warnings": warnings,
        "horizon": settings["window"],
        "rmse": scored.errors(start, everything).rmse(),
        "rmse_hold_last_state": scored.held(everything),
        "slips_covered": slips_covered(vehicle, scored.states()),
    }
    theta, draws = start, np.empty((0, len(start)))
    if task is not None:
        solution = _solve(task, np.arange(task.cut.windows.count), settings, lambda share: on_progress("fit", share))
        theta = solution.fit.point.theta
        uncertainty = estimate(
            solution.fit, solution.objective, task.cut.run, solution.independent, int(settings["seed"])
        )
        draws = uncertainty.draws[:DRAWS]
        facts["rmse_unfitted"] = facts["rmse"]
        facts |= _hold_out(task, scored, settings, lambda share: on_progress("held-out runs", share))
        facts |= _result(task, solution, uncertainty)
        facts["warnings"] = [*warnings, *_fit_warnings(facts)]
        write_model(folder.path / MODEL, settings["vehicle"], dict(zip(rollout.names, theta, strict=True)), facts)
    facts["warnings"] += _stiffness_warnings(rollout, theta, scored)
    facts["residuals"] = {"unfitted": scored.histogram(start), "fitted": scored.histogram(theta)}
    write_bytes(folder.path / OVERLAY, _parquet(scored.overlay(start, theta)))
    write_bytes(folder.path / TYRES, _parquet(tyre_curves(vehicle, rollout.names, theta, draws)))
    write_json(folder.path / RESULT, facts)
    folder.finish(seconds=round(time.perf_counter() - began, 2))
    return facts


def _check(settings: Mapping[str, Any]) -> None:
    whole = {"window": (2, 10_000), "starts": (1, 100), "folds": (0, 100), "seed": (0, 2**31)}
    for key, (low, high) in whole.items():
        value = settings[key]
        if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
            raise ConfigError(f"{key} = {value}: allowed is a whole number, {low} … {high}")
    if settings["folds"] == 1:
        raise ConfigError("folds = 1: allowed is 0 (nothing is held out) or 2 … 100")
    if settings["inputs"] not in INPUTS:
        raise ConfigError(f"inputs = {settings['inputs']}: allowed is {', '.join(INPUTS)}")
    if not isinstance(settings["fit"], bool):
        raise ConfigError(f"fit = {settings['fit']}: allowed is true or false")
    for key, (lowest, highest, unit) in {"slowest": (0.0, 50.0, "m/s"), "step": (1e-4, 0.1, "s")}.items():
        number = settings[key]
        if isinstance(number, bool) or not isinstance(number, (int, float)) or not lowest <= number <= highest:
            raise ConfigError(f"{key} = {number}: allowed is {lowest:g} … {highest:g} {unit}")


def _task(
    settings: Mapping[str, Any], rollout: Rollout, unknowns: Unknowns, layout: Layout, logs: Sequence[Log]
) -> Task:
    length = settings["window"]
    samples = sum(len(log.table) for log in logs)
    stride = int(np.clip(samples // MOST_WINDOWS, max(1, length // 5), length))
    windows = cut(logs, layout, rollout.vehicle, length, stride, settings["slowest"])
    for channel, weight in settings["weights"].items():
        if isinstance(weight, bool) or not isinstance(weight, (int, float)) or not 0 <= weight < np.inf:
            raise ConfigError(f"weights.{channel} = {weight}: allowed is a number ≥ 0")
    return Task(
        rollout,
        unknowns,
        windows,
        channel_scale(logs, layout.observed),
        np.array([float(settings["weights"].get(channel, 1.0)) for channel in layout.observed]),
        max(1.0, (length + 1) / stride),
        registry.create(methods_package, settings["method"]),
        settings["threads"],
    )


def _solve(
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
    channels = len(task.rollout.observed)
    objective = task.objective(index, len(index) * channels, 0.0)
    first = objective.linearise(objective.start(task.unknowns.start))
    if not np.isfinite(first.cost):
        raise LogError("the given vehicle diverges on this log; check vehicle=… and the log's units")
    objective = task.objective(index, len(index) * channels, first.data)
    best: Fit | None = None
    for theta in starts:
        fit = task.method.fit(objective, objective.start(theta), on_step)
        if best is None or fit.linearised.cost < best.linearised.cost:
            best = fit
        done += 1
    assert best is not None  # noqa: S101
    for _ in range(ROUNDS):
        independent = independent_residuals(objective.residuals(best.point)) / task.overlap
        objective = task.objective(index, independent, best.linearised.data)
        best = task.method.fit(objective, best.point, on_step)
        done += 1
    return Solution(best, objective, independent)


def _result(task: Task, solution: Solution, uncertainty: Uncertainty) -> dict[str, Any]:
    """Return what the fit says of the parameters."""
    fit, at = solution.fit, solution.fit.linearised
    parameters, pairs = describe(fit, solution.objective, uncertainty)
    return {
        "parameters": parameters,
        "not_separable": pairs,
        "at_bound": [name for name, facts in parameters.items() if facts["at_bound"]],
        "far_from_prior": [name for name, facts in parameters.items() if abs(facts["from_prior"]) > FAR],
        "held": {name: float(value) for name, value in values(task.rollout.vehicle).items() if name not in parameters},
        "method": {
            "name": _snake(type(task.method).__name__),
            "converged": fit.converged,
            "cost": at.cost,
            "data": at.data,
            "iterations": fit.iterations,
            "windows": task.cut.windows.count,
            "independent_residuals": solution.independent,
            "scale": dict(zip(task.rollout.observed, task.scale.tolist(), strict=True)),
        },
    }


def _fit_warnings(facts: Mapping[str, Any]) -> list[str]:
    """Return what a user should know before trusting the values."""
    warnings = []
    for name in facts["far_from_prior"]:
        p = facts["parameters"][name]
        warnings.append(
            f"{name} went from {p['start']:.4g} to {p['value']:.4g} {p['unit']}, {abs(p['from_prior']):.0f} deviations "
            "of its prior: it may stand in for an effect that the model lacks"
        )
    if facts["at_bound"]:
        warnings.append(f"at a physical bound: {', '.join(facts['at_bound'])}")
    if not any(p["identified"] for p in facts["parameters"].values()):
        warnings.append("no parameter is known to 5 % from the data alone: the log excites the car too little")
    if not facts["method"]["converged"]:
        warnings.append("the fit has not converged; allow more method.iterations")
    return warnings


def _stiffness_warnings(rollout: Rollout, theta: Array, scored: "Scored") -> list[str]:
    """Return a line when the integration step is too long for the car at the log's slowest."""
    car = replace_values(rollout.vehicle, dict(zip(rollout.names, theta, strict=True)))
    _, h = rollout.steps(scored.cut.windows.dt)
    rate = fastest_rate(car, scored.cut.windows.initial)
    if rate * h < STABLE:
        return []
    return [f"the car is too stiff for steps of {h:g} s at its slowest in this log; give step={STABLE / rate:.1g}"]


def _hold_out(
    task: Task, scored: "Scored", settings: Mapping[str, Any], on_share: Callable[[float], None]
) -> dict[str, Any]:
    """Return the errors in runs that the fit has not seen: each run is held out once."""
    if not settings["folds"]:
        return {"rmse": None, "held_out": "nothing"}
    folds, how = deal(scored.cut, settings["folds"])
    total = ErrorSum(scored.rollout.observed, scored.horizons)
    for number, fold in enumerate(folds):
        seen, unseen = np.flatnonzero(fold.seen(task.cut)), np.flatnonzero(fold.unseen(scored.cut))
        if not len(seen) or not len(unseen):
            continue

        def on_fold(share: float, number: int = number) -> None:
            on_share((number + share) / len(folds))

        fitted = _solve(task, seen, {**settings, "starts": 1}, on_fold)
        total.add(scored.rollout_errors(fitted.fit.point.theta, unseen))
    if not total.count:
        return {"rmse": None, "held_out": "nothing: the log is too short to be parted"}
    return {"rmse": total.rmse(), "held_out": how}


class Scored:
    """Predictions of a log from measured initial states, apart from any fit."""

    def __init__(self, rollout: Rollout, layout: Layout, logs: Sequence[Log], settings: Mapping[str, Any]) -> None:
        self.rollout, self.threads = rollout, settings["threads"]
        self.horizons = horizons_within(settings["window"])
        # a long log is scored with fewer starts, which costs no accuracy worth having
        every = max(START_EVERY, sum(len(log.table) for log in logs) // MOST_SCORED)
        self.cut = cut(logs, layout, rollout.vehicle, settings["window"], every, 0.0)

    def rollout_errors(self, theta: Array, index: NDArray[np.int64]) -> Array:
        """Return simulated minus measured channels of some windows, (T + 1, C, W)."""
        return rollout_errors(self.rollout, theta, self.cut.take(index), self.threads)

    def errors(self, theta: Array, index: NDArray[np.int64]) -> ErrorSum:
        """Return the squared errors of some windows."""
        total = ErrorSum(self.rollout.observed, self.horizons)
        total.add(self.rollout_errors(theta, index))
        return total

    def held(self, index: NDArray[np.int64]) -> Table:
        """Return the RMSE of holding the first sample."""
        total = ErrorSum(self.rollout.observed, self.horizons)
        total.add(held_errors(self.cut.take(index)))
        return total.rmse()

    def states(self) -> Array:
        """Return the measured initial states of all windows, with what drives the car in place of its actuators."""
        return self.cut.windows.initial[: len(STATE)]

    def histogram(self, theta: Array) -> dict[str, Any]:
        """Return counts of the errors at the window's end by channel, over ± 4 of their standard deviations."""
        errors = self.rollout_errors(theta, np.arange(self.cut.windows.count))[-1]
        table = {}
        for name, row in zip(self.rollout.observed, errors, strict=True):
            row = row[np.isfinite(row)]
            limit = 4.0 * float(np.std(self.cut.windows.measured[:, self.rollout.observed.index(name)]))
            counts, edges = np.histogram(row, bins=81, range=(-limit, limit))
            table[name] = {"edges": edges.tolist(), "counts": counts.tolist()}
        return table

    def overlay(self, start: Array, theta: Array) -> pd.DataFrame:
        """Return successive rollouts through the run of median error, by rollout and channel."""
        errors = self.rollout_errors(theta, np.arange(self.cut.windows.count))
        power = np.nan_to_num((errors / self.cut.windows.measured.std(axis=(0, 2))[:, None]) ** 2, nan=np.inf)
        runs = np.unique(self.cut.run)
        by_run = np.array([power[..., self.cut.run == run].mean() for run in runs])
        run = runs[np.argsort(by_run, kind="stable")[len(runs) // 2]]
        index: list[int] = []
        reached = -1
        for i in np.flatnonzero(self.cut.run == run):
            if self.cut.start[i] >= reached and len(index) < OVERLAY_ROLLOUTS:
                index.append(int(i))
                reached = self.cut.start[i] + len(errors) - 1
        part = self.cut.take(np.array(index))
        rows = [self.rollout.vehicle.states.index(name) for name in self.rollout.observed]
        simulated = {
            label: self.rollout.simulate(values_, part.windows, self.threads)[:, rows]
            for label, values_ in (("unfitted", start), ("fitted", theta))
        }
        time_ = (part.start + np.arange(len(errors))[:, None]) * part.windows.dt  # (T + 1, W)
        return pd.concat(
            [
                pd.DataFrame(
                    {
                        "t": time_[:, w],
                        "rollout": w,
                        "channel": name,
                        "measured": part.windows.measured[:, c, w],
                        **{label: table[:, c, w] for label, table in simulated.items()},
                    }
                )
                for c, name in enumerate(self.rollout.observed)
                for w in range(len(index))
            ],
            ignore_index=True,
        )


def _snake(name: str) -> str:
    return re.sub(r"(?<!^)(?=[A-Z])", "_", name).lower()


def _log_facts(log: Log) -> dict[str, Any]:
    return {
        "name": log.name,
        "seconds": round(log.seconds, 3),
        "runs": int(log.table["run"].nunique()),
        "dt": log.dt,
        "channels": log.channels,
        "remarks": list(log.remarks),
    }


def _parquet(table: pd.DataFrame) -> bytes:
    stream = io.BytesIO()
    table.to_parquet(stream, index=False)
    return stream.getvalue()
