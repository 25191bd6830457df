"""The identify stage: fit a vehicle to logs, say how sure the values are, and score it on runs it has not seen.

Writes `model.yaml` (the vehicle, fitted to all runs), `identification.json` (values, intervals, what is not separable,
held-out errors, and the verdict: whether the car is usable, and why), `cars.parquet` (cars that the logs leave
possible), and `overlay.parquet` and `tyres.parquet`, which the report draws. With `fit=false` the vehicle is only
scored: no `model.yaml`, and the errors are the given vehicle's.
"""

import re
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from racerl import bounds
from racerl.assemble import use_threads
from racerl.data.inspect import compare, inspect, lines_of
from racerl.data.load import load_measured
from racerl.data.log import CHANNELS, Log, separate
from racerl.documents import write_json, write_parquet
from racerl.errors import ConfigError, LogError
from racerl.estimation.unknowns import HELD, Unknowns, choose_unknowns
from racerl.identify.document import write_model
from racerl.identify.folds import deal
from racerl.identify.score import ErrorSum
from racerl.identify.scored import Scored
from racerl.identify.task import Solution, Task, make_task, plan, solve
from racerl.identify.timing import aligned
from racerl.identify.told import open_questions
from racerl.identify.tyres import slips_covered, tyre_curves
from racerl.identify.uncertainty import Uncertainty, describe
from racerl.identify.verdict import judge
from racerl.identify.windows import INPUTS, Wiring, choose_wiring
from racerl.identify.work import Progress, Work
from racerl.run import RunFolder
from racerl.vehicle.cars import write_cars
from racerl.vehicle.load import load_vehicle
from racerl.vehicle.parameter import replace_values, values
from racerl.vehicle.rollout import Equations, Rollout, fastest_rate, on_threads
from racerl.vehicle.vehicle import Vehicle

Array = NDArray[np.float64]
RESULT, MODEL, OVERLAY, TYRES = "identification.json", "model.yaml", "overlay.parquet", "tyres.parquet"
DRAWS = 200  # of the parameters, for the tyre curves' band
STABLE = 2.5  # largest step × rate
FAR = 3.0  # deviations of its prior, beyond which a value is worth a remark


def identify(
    settings: Mapping[str, Any], out: Path, on_progress: Progress = lambda share, remark: None
) -> dict[str, Any]:
    """Identify the vehicle of `settings` from its logs; return what was written to identification.json.

    Raises LogError for logs that can't be fitted and ConfigError for settings out of range, before anything is written.
    """
    check(settings)
    use_threads(settings["threads"])
    with on_threads(settings["threads"]):
        return _identified(settings, out, on_progress)


def _identified(settings: Mapping[str, Any], out: Path, on_progress: Progress) -> dict[str, Any]:
    began = time.perf_counter()
    configured = load_vehicle(settings["vehicle"])
    logs, said = _read(settings, configured)
    wiring = choose_wiring(logs, settings["inputs"])
    vehicle = wiring.driven(configured)
    unknowns = _unknowns(settings, vehicle, configured, wiring) if settings["fit"] else None
    rollout = Rollout(vehicle, unknowns.names if unknowns else (), wiring.observed, settings["step"])
    scored = Scored(rollout, wiring, logs, settings)
    _check_stable(scored, rollout.nominal())
    task = make_task(settings, rollout, unknowns, wiring, logs) if unknowns else None

    folder = RunFolder.start(out, "identify", settings, seed=settings["seed"], threads=settings["threads"])
    start = theta = rollout.nominal()
    draws = np.empty((0, len(start)))
    facts: dict[str, Any] = {
        "fitted": task is not None,
        "logs": [log.facts() for log in logs],
        "inputs": {"steering": wiring.steering, "drive": wiring.drive},
        **said,
        "horizon": settings["window"],
        "slips_covered": slips_covered(vehicle, scored.states()),
    }
    if task is None:
        facts |= _errors(scored, start)
    else:
        solution, held_out = _solve(task, scored, settings, on_progress)
        uncertainty = solution.uncertainty(task, settings["seed"])
        theta, draws = solution.fit.point.theta, uncertainty.draws
        facts |= {**held_out, **_result(task, solution, uncertainty)}
        facts["warnings"] += _fit_warnings(facts)
    facts["warnings"] += _stiffness_warnings(scored, theta)
    facts["verdict"] = judge(facts)
    facts["warnings"] = [*_growth_warnings(facts), *facts["warnings"]]
    facts["residuals"] = {"unfitted": scored.histogram(start), "fitted": scored.histogram(theta)}
    _write(folder.path, settings, scored, theta, draws, facts)
    folder.finish(seconds=round(time.perf_counter() - began, 2))
    return facts


def _read(settings: Mapping[str, Any], configured: Vehicle) -> tuple[list[Log], dict[str, list[str]]]:
    """Return the logs, in step with the vehicle's latencies, and the warnings and contradictions of them."""
    logs, warnings = separate(load_measured(settings))
    logs = [aligned(log, configured) for log in logs]
    warnings += compare(logs)
    inspected = [inspect(log, float(configured.wheelbase)) for log in logs]
    warnings += lines_of(inspected, "warnings")
    return logs, {"warnings": warnings, "contradictions": lines_of(inspected, "contradictions")}


def _errors(scored: Scored, theta: Array) -> dict[str, Any]:
    """Return the errors of a vehicle that was not fitted, in all windows."""
    everything = np.arange(scored.cut.windows.count)
    return {
        "rmse": scored.errors(theta, everything).rmse(),
        "rmse_hold_last_state": scored.errors_of_holding(everything).rmse(),
    }


def _write(
    folder: Path, settings: Mapping[str, Any], scored: Scored, theta: Array, draws: Array, facts: Mapping[str, Any]
) -> None:
    """Write what was found: parameters θ (P,), draws of them (K, P), the facts."""
    rollout = scored.rollout
    if facts["fitted"]:
        write_model(folder / MODEL, settings["vehicle"], dict(zip(rollout.names, theta, strict=True)), facts)
        write_cars(folder, rollout.vehicle, rollout.names, draws)
    write_parquet(folder / OVERLAY, scored.overlay(rollout.nominal(), theta))
    write_parquet(folder / TYRES, tyre_curves(rollout.vehicle, rollout.names, theta, draws[:DRAWS]))
    write_json(folder / RESULT, facts)


def check(settings: Mapping[str, Any]) -> None:
    """Raise ConfigError for settings of the wrong kind or out of range."""
    whole = {"window": (2, 10_000), "starts": (1, 100), "folds": (0, 100), "seed": (0, 2**31)}
    for key, (low, high) in whole.items():
        bounds.whole(key, settings[key], low, high)
    if settings["folds"] == 1:
        raise ConfigError("folds = 1: allowed is 0 (nothing is held out) or 2 … 100")
    if settings["inputs"] not in INPUTS:
        raise ConfigError(f"inputs = {settings['inputs']}: allowed is {', '.join(INPUTS)}")
    if not isinstance(settings["fit"], bool):
        raise ConfigError(f"fit = {settings['fit']}: allowed is true or false")
    bounds.number("slowest", settings["slowest"], 0.0, 50.0, "m/s")
    bounds.number("step", settings["step"], 1e-4, 0.1, "s")
    for key in ("priors", "weights"):
        if not isinstance(settings[key], Mapping):
            raise ConfigError(f"{key} = {settings[key]}: a mapping is expected, for instance {key}={{}}")
    bounds.words("hold", settings["hold"], HELD)


def _unknowns(settings: Mapping[str, Any], vehicle: Vehicle, configured: Vehicle, wiring: Wiring) -> Unknowns:
    """Return what the fit may change: of effects only what a rollout shows; latencies and dead times are given."""
    chosen = choose_unknowns(vehicle, settings["priors"], settings["hold"], configured)
    if not any(name.startswith("effects.") for name in chosen.names):
        return chosen
    shown = Equations(vehicle, chosen.names, wiring.observed).effective
    return chosen.only([name for name in chosen.names if name in shown or not name.startswith("effects.")])


def _result(task: Task, solution: Solution, uncertainty: Uncertainty) -> dict[str, Any]:
    """Return what the fit says of the parameters."""
    fit, at = solution.fit, solution.fit.linearised
    parameters, pairs = describe(task.unknowns, fit.point.theta, uncertainty)
    left_open = open_questions(task.unknowns, *solution.posterior)
    for name in (name for names in left_open["untold"].values() for name in names):
        parameters[name]["told"] = False
    return {
        "parameters": parameters,
        "not_separable": pairs,
        "open": left_open,
        "at_bound": [name for name, facts in parameters.items() if facts["at_bound"]],
        "far_from_prior": [name for name, facts in parameters.items() if abs(facts["from_prior"]) > FAR],
        "actuators_alone": [name for part in solution.actuators for name in part.values],
        "fixed": {name: float(value) for name, value in values(task.rollout.vehicle).items() if name not in parameters},
        "method": {
            "name": _snake(type(task.method).__name__),
            "converged": bool(solution.converged),
            "cost": at.cost,
            "data": at.data,
            "steps": fit.steps,
            "windows": task.cut.windows.count,
            "independent_residuals": float(solution.independent),
            "scale": dict(zip(task.rollout.observed, task.scale.tolist(), strict=True)),
        },
    }


def _growth_warnings(facts: Mapping[str, Any]) -> list[str]:
    """Return a line for each channel that the fit has made worse."""
    return [
        f"{name} errs {row['factor']:.2f} times as much as before in runs held out ({row['before']:.4f} → "
        f"{row['after']:.4f} {CHANNELS[name].unit}): the model lacks something, or the log is too short"
        for name, row in facts["verdict"]["channels"].items()
        if row["grew"]
    ]


def _fit_warnings(facts: Mapping[str, Any]) -> list[str]:
    """Return what a user should know before trusting the values."""
    warnings = []
    for name in facts["far_from_prior"]:
        p = facts["parameters"][name]
        warnings.append(
            f"{name} went from {p['start']:.4g} to {p['value']:.4g}{' ' * bool(p['unit'])}{p['unit']}, "
            f"{abs(p['from_prior']):.0f} deviations of its prior: it may stand in for an effect that the model lacks"
        )
    if facts["at_bound"]:
        warnings.append(f"at a physical bound: {', '.join(facts['at_bound'])}")
    if not any(p["identified"] for p in facts["parameters"].values()):
        warnings.append("no parameter is known to 5 % from the data alone: the log excites the car too little")
    if not facts["method"]["converged"]:
        warnings.append("the fit has not converged; allow more method.iterations")
    return warnings


def _check_stable(scored: Scored, theta: Array) -> None:
    """Raise LogError for a vehicle whose simulation leaves what a small car can show."""
    with np.errstate(all="ignore"):
        errors = scored.rollout_errors(theta, np.arange(scored.cut.windows.count))
        rms = np.sqrt((errors**2).mean(axis=(0, 2)))
    for name, value in zip(scored.rollout.observed, rms, strict=True):
        if not value <= CHANNELS[name].largest:
            raise LogError(
                f"the given vehicle diverges on this log, {name} is off by {value:.3g} {CHANNELS[name].unit}; "
                f"check vehicle=… and the log's units, or give step={_stable_step(scored, theta)[1]:.2g}"
            )


def _stable_step(scored: Scored, theta: Array) -> tuple[float, float]:
    """Return the integration step and the longest one that is stable at the log's slowest."""
    car = replace_values(scored.rollout.vehicle, dict(zip(scored.rollout.names, theta, strict=True)))
    _, h = scored.rollout.steps(scored.cut.windows.dt)
    return h, 0.9 * STABLE / fastest_rate(car, scored.cut.windows.initial)


def _stiffness_warnings(scored: Scored, theta: Array) -> list[str]:
    """Return a line when the integration step is too long for the car at the log's slowest."""
    h, stable = _stable_step(scored, theta)
    if 0.9 * h < stable:
        return []
    return [f"the car is too stiff for steps of {h:g} s at its slowest in this log; give step={stable:.2g}"]


def _parts(task: Task, scored: Scored, count: int) -> tuple[list[tuple[NDArray[np.int64], NDArray[np.int64]]], str]:
    """Return the windows that each fold fits and is judged by, and a line that says how they were held out."""
    if not count:
        return [], "nothing"
    folds, how = deal(scored.cut, count)
    parts = [(np.flatnonzero(fold.seen(task.cut)), np.flatnonzero(fold.unseen(scored.cut))) for fold in folds]
    parts = [(seen, unseen) for seen, unseen in parts if len(seen) and len(unseen)]
    if not parts:
        return [], f"nothing: the log is too short to be parted in folds={count}"
    return parts, f"{how}; {len(parts)} counted" if len(parts) < len(folds) else how


def _solve(
    task: Task, scored: Scored, settings: Mapping[str, Any], on_progress: Progress
) -> tuple[Solution, dict[str, Any]]:
    """Return the fit to all runs, and the errors in runs held out of one each, beside those of the vehicle given.

    The fits of the folds start from the vehicle given only.
    """
    parts, how = _parts(task, scored, settings["folds"])
    windows, starts, seed = np.arange(task.cut.windows.count), settings["starts"], settings["seed"]
    fits = [*plan(len(windows), starts), *(fit for seen, _ in parts for fit in plan(len(seen), 1))]
    work = Work(fits, on_progress)
    solution = solve(task, windows, seed, starts, work)
    total = ErrorSum(scored.rollout.observed, scored.horizons)
    for seen, unseen in parts:
        total.add(scored.rollout_errors(solve(task, seen, seed, 1, work).fit.point.theta, unseen))
    everything = [np.arange(scored.cut.windows.count)]
    index = np.concatenate([unseen for _, unseen in parts] or everything)
    return solution, {
        "rmse": total.rmse() if parts else None,
        "rmse_unfitted": scored.errors(task.unknowns.start, index).rmse(),
        "rmse_hold_last_state": scored.errors_of_holding(index).rmse(),
        "held_out": how,
    }


def _snake(name: str) -> str:
    return re.sub(r"(?<!^)(?=[A-Z])", "_", name).lower()
