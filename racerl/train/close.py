"""`racerl gap close`: policies race in the car that the log came from.

`old` was trained on the refitted vehicle without the effects found, `new` on the vehicle of the diagnosis, which has
them, `oracle` on the car itself, each several times; `refined` is `old`, refined on the vehicle of the diagnosis, where
the budget has a refinement. Of the oracle's gain, in lap time, in leaving the track or in crashes, naming the effect
recovered the share (old − new)/(old − oracle), of the trainings' means; its interval is a bootstrap over the trainings.
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np

from racerl import bounds
from racerl.control.policy import improved_by
from racerl.data.load import load_given
from racerl.documents import read_json, write_json
from racerl.errors import ConfigError, VehicleError
from racerl.evaluate.evaluate import evaluate, seeds_of
from racerl.evaluate.outcome import METRICS
from racerl.gap.diagnose import MODEL, MODEL_BEFORE, VERDICT, gap
from racerl.run import Compose, RunFolder, is_complete
from racerl.train.onward import train_onward
from racerl.train.train import improvement_of, require_sound, train
from racerl.vehicle.load import load_vehicle

RESULT = "close.json"
MEASURES = ("mean_lap_s", "e_off", "crash_share")  # less is better
RESAMPLES, TAIL = 4000, 2.5  # of the bootstrap; its tails in percent
SHOWN = (*MEASURES, "fastest_valid_lap_s", "laps", "valid_laps")
# words for training that the refinement of a policy follows, too
ONWARD = ("budget", "device", "threads", "vehicle", "seed")


def close(
    settings: Mapping[str, Any],
    out: Path,
    compose: Compose,
    on_progress: Callable[[float, str], None] = lambda share, what: None,
) -> dict[str, Any]:
    """Train and race the policies; return what was written to close.json.

    Raises RunError for a run that is no finished diagnosis, ConfigError where nothing was named that could be added.
    """
    logs = [settings["logs"]] if isinstance(settings["logs"], str) else list(settings["logs"])
    finished = len(logs) == 1 and Path(logs[0]).is_dir()
    diagnosis = compose("gap", [f"logs={logs}", f"threads={settings['threads']}", *map(str, settings["gap"])])
    words, trainings, race = _words(settings), _trainings(settings), _race(settings)
    # what cannot be read is told before anything is written
    training = _training(settings["real"], words, compose)
    improvement_of(training)
    if finished:
        _verdict(Path(logs[0]))
    else:
        load_given(diagnosis)
    folder = RunFolder.start(out, "close", settings, threads=settings["threads"])
    found = Path(logs[0]) if finished else folder.path / "gap"
    if not finished and not is_complete(found):
        gap(diagnosis, found, lambda what, share: on_progress(0.0, what))
    verdict = _verdict(found)
    cars = {"old": found / MODEL_BEFORE, "refined": found / MODEL, "new": found / MODEL, "oracle": settings["real"]}
    if not improved_by(training["budget"]):
        del cars["refined"]
    rows: dict[str, list[dict[str, Any]]] = {kind: [] for kind in cars}
    jobs = [(seed, kind) for seed in trainings for kind in cars]
    for i, (seed, kind) in enumerate(jobs):
        on_progress(i / len(jobs), f"{kind}, seed {seed}: training")
        trained, raced = folder.path / f"{kind}_{seed}", folder.path / f"{kind}_{seed}_race"
        if not is_complete(trained):
            before = folder.path / f"old_{seed}" if kind == "refined" else None
            _train(trained, before, [*words, f"vehicle={cars[kind]}", f"seed={seed}"], compose)
        require_sound(trained)
        on_progress((i + 0.7) / len(jobs), f"{kind}, seed {seed}: racing")
        if not is_complete(raced):
            evaluate(compose("evaluate", [f"run={trained}", *race]), raced)
        rows[kind].append({"seed": seed, **_row(trained, raced)})
    facts = {"effects": [effect["name"] for effect in verdict["effects"]], **_compared(rows)}
    write_json(folder.path / RESULT, facts)
    folder.finish()
    return facts


def _train(out: Path, before: Path | None, words: Sequence[str], compose: Compose) -> None:
    """Train a policy, or refine the one that was trained before."""
    if before is None:
        train(compose("train", words), out)
    else:
        onward = [word for word in words if word.lstrip("+~").partition("=")[0].partition(".")[0] in ONWARD]
        train_onward(compose("refine", [f"from={before}", *onward]), out)


def _row(trained: Path, raced: Path) -> dict[str, Any]:
    """Return how long a policy was trained, in s, and how it raced."""
    seconds = RunFolder.open_complete(trained, "train").manifest["seconds"]
    return {"training_s": seconds, **{key: read_json(raced / METRICS)[key] for key in SHOWN}}


def _compared(rows: Mapping[str, Sequence[Mapping[str, Any]]]) -> dict[str, Any]:
    """Return the means of every kind's trainings, and the shares of the oracle's gain that they recovered."""
    policies: dict[str, dict[str, Any]] = {kind: {**means(each), "trainings": each} for kind, each in rows.items()}
    facts: dict[str, Any] = {"policies": policies}
    for kind, key in (("new", "recovered"), ("refined", "recovered_by_refining")):
        if kind in rows:
            three = ("old", kind, "oracle")
            facts[key] = {m: recovered(*(policies[each][m] for each in three)) for m in MEASURES}
            facts[f"{key}_ci95"] = {m: interval([rows[each] for each in three], m) for m in MEASURES}
    return facts


def means(trainings: Sequence[Mapping[str, Any]]) -> dict[str, float | None]:
    """Return the mean of every measure over trainings; None where one has no lap to take it from."""
    columns = {measure: [row[measure] for row in trainings] for measure in MEASURES}
    return {measure: None if None in column else fmean(column) for measure, column in columns.items()}


def _training(real: str, words: Sequence[str], compose: Compose) -> dict[str, Any]:
    """Return the settings of a training on the car itself; errors in it are told of `real`, as it was given."""
    try:
        training = compose("train", [f"vehicle={real}", *words])
        load_vehicle(training["vehicle"])
    except (ConfigError, VehicleError) as error:
        told = str(error)
        if told.startswith(f"vehicle = {real}:"):
            told = "real" + told.removeprefix("vehicle")
        elif isinstance(error, VehicleError):
            told = f"real = {real}: {told.removesuffix(f' (with vehicle={real})')}"
        raise type(error)(told) from error
    return training


def _words(settings: Mapping[str, Any]) -> list[str]:
    """Return the words that all trainings follow; raise ConfigError where one names a vehicle."""
    words = [*map(str, settings["train"]), f"threads={settings['threads']}"]
    if mine := [word for word in words if word.lstrip("+~").startswith("vehicle")]:
        raise ConfigError(
            f"train = {mine[0]}: each policy has a vehicle of its own; real= is the car, gap= has the rest"
        )
    return words


def _race(settings: Mapping[str, Any]) -> list[str]:
    """Return the words that all races follow."""
    seeds, laps = seeds_of(settings["seeds"]), bounds.whole("laps", settings["laps"], 1, 10_000)
    return [f"vehicle={settings['real']}", f"laps={laps}", f"seeds={seeds}"]


def _trainings(settings: Mapping[str, Any]) -> list[int]:
    """Return the seeds that the policies are trained with; raise ConfigError when they are none or alike."""
    seeds = bounds.wholes("trainings", settings["trainings"], 0, 2**31)
    if not seeds or len(set(seeds)) < len(seeds):
        raise ConfigError(f"trainings = {seeds}: a list of different seeds is expected, such as [0,1,2]")
    return seeds


def _verdict(run: Path) -> dict[str, Any]:
    """Return the verdict of a finished diagnosis; raise ConfigError where it holds no effect."""
    verdict = read_json(RunFolder.open_complete(run, "gap").path / VERDICT)
    if not verdict["effects"]:
        raise ConfigError(f"{run}: its verdict is {verdict['verdict']}, there is no effect to train with")
    return verdict


def recovered(old: float | None, new: float | None, oracle: float | None) -> float | None:
    """Return the share of the oracle's gain; None where a policy has no such measure, or the oracle gains nothing."""
    if old is None or new is None or oracle is None or old <= oracle:
        return None
    return (old - new) / (old - oracle)


def interval(rows: Sequence[Sequence[Mapping[str, Any]]], measure: str) -> tuple[float, float] | None:
    """Return the 95 % interval of the share recovered; None where trainings don't show that the oracle gains at all.

    `rows` are those of the old, the new and the oracle's trainings.
    """
    generator = np.random.default_rng(0)
    columns = [[row[measure] for row in trainings] for trainings in rows]
    if any(None in column for column in columns):
        return None
    old, new, oracle = (generator.choice(column, size=(RESAMPLES, len(column))).mean(axis=1) for column in columns)
    gains = old > oracle
    if len(columns[0]) < 2 or np.mean(~gains) > TAIL / 100.0:
        return None
    low, high = np.percentile((old - new)[gains] / (old - oracle)[gains], [TAIL, 100.0 - TAIL])
    return float(low), float(high)
