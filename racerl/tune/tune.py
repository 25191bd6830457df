"""The tune stage: looks for the numbers with which a controller laps fastest on the model, or on a randomization of it.

Every trial drives the same starts. What is minimised is the time driven per valid lap,
with `CRASH` seconds for a lap that ends in a crash: a lap off the track costs its time and counts for nothing. The
first trial has the numbers that the controller comes with, so that what is found is never worse on these starts. Writes
`controller.yaml`, which is taken as controller=FILE, and `tune.json`.
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from racerl import bounds
from racerl.assemble import Car, use_threads
from racerl.control.controllers import create_controller, read_controller
from racerl.documents import write_json, write_yaml
from racerl.errors import ConfigError, RacerlError, suggest
from racerl.evaluate.drive import drive
from racerl.evaluate.evaluate import seeds_of
from racerl.evaluate.laps import Lap, score
from racerl.evaluate.rivals import prepare
from racerl.run import RunFolder

CONTROLLER, RESULT = "controller.yaml", "tune.json"
CRASH = 10.0  # s
NEVER = 1000.0  # s per valid lap, where there is none


def tune(
    settings: Mapping[str, Any], out: Path, on_trial: Callable[[int, float], None] = lambda done, best: None
) -> dict[str, Any]:
    """Return what is written to tune.json: all trials and the best; `on_trial` hears how many and the best so far."""
    optuna = _optuna()
    use_threads(settings["threads"])
    trials = bounds.whole("trials", settings["trials"], 1, 100_000)
    first = read_controller(settings["controller"])
    ranges = _ranges(first, settings["search"])
    seed = bounds.whole("seed", settings["seed"], 0, 2**32 - 1)
    bounds.whole("laps", settings["laps"], 1, 10_000)
    seeds_of(settings["seeds"])
    folder = RunFolder.start(out, "tune", settings, seed=seed, threads=settings["threads"])
    study = optuna.create_study(sampler=optuna.samplers.TPESampler(seed=seed))
    study.enqueue_trial({name: first[name] for name in ranges})
    rows: list[dict[str, Any]] = []
    for number in range(trials):
        trial = study.ask()
        numbers = {name: trial.suggest_float(name, low, high, log=True) for name, (low, high) in ranges.items()}
        row = {**numbers, **try_out({**settings, "controller": {**first, **numbers}})}
        study.tell(trial, row["seconds_per_valid_lap"])
        rows.append(row)
        best = min(rows, key=lambda each: float(each["seconds_per_valid_lap"]))
        if best is row:
            write_yaml(folder.path / CONTROLLER, {**first, **numbers})
        on_trial(number + 1, best["seconds_per_valid_lap"])
    facts = {"best": best, "trials": rows}
    write_json(folder.path / RESULT, facts)
    folder.finish(seconds_per_valid_lap=best["seconds_per_valid_lap"])
    return facts


def try_out(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return how a controller drives: seconds per valid lap, mean lap, valid laps and crashes."""
    field, controller = prepare(settings, Car("model", drift=settings["dr"]))
    laps = drive(field, controller, bounds.whole("laps", settings["laps"], 1, 10_000))
    scored = score(laps)
    kept = ("mean_lap_s", "laps", "valid_laps", "crash_share", "e_off")
    return {"seconds_per_valid_lap": per_valid_lap(laps), **{key: scored[key] for key in kept}}


def per_valid_lap(laps: Sequence[Lap]) -> float:
    """Return the seconds that were driven for every valid lap."""
    driven = sum(CRASH if lap.time_s is None else lap.time_s for lap in laps)
    valid = sum(lap.valid for lap in laps)
    return driven / valid if valid else NEVER


def _ranges(controller: Mapping[str, Any], search: Mapping[str, Any] | None) -> dict[str, tuple[float, float]]:
    """Return the least and greatest value of every number that is looked for, the controller's own unless given."""
    design = create_controller(controller)
    search = getattr(design, "SEARCH", {}) if search is None else search
    if not isinstance(search, Mapping) or not search:
        raise ConfigError("search: a mapping from the controller's numbers to [least, greatest] is expected")
    ranges = {}
    for name, pair in search.items():
        if not isinstance(controller.get(name), float):
            numbers = [key for key, value in controller.items() if isinstance(value, float)]
            raise ConfigError(f"search.{name}: the controller has no such number{suggest(name, numbers)}")
        expected = "two numbers are expected, [least, greatest]"
        low, high = bounds.pair(f"search.{name}", pair, 1e-9, 1e9, expected)
        if not low < high or not low <= controller[name] <= high:
            raise ConfigError(f"search.{name} = {pair}: least < greatest around {controller[name]:g} is expected")
        for end in (low, high):
            create_controller({**controller, name: end})  # its own limits
        ranges[name] = (low, high)
    return ranges


def _optuna() -> Any:
    try:
        import optuna
    except ModuleNotFoundError as error:
        raise RacerlError("racerl tune needs optuna: in your clone, pip install -e '.[tune]'") from error
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    return optuna
