"""`racerl gap close`: three policies race in the car that the log came from.

`old` was trained on the refitted vehicle without the effects found, `new` with them, `oracle` on the car itself. Of the
oracle's gain in lap time, naming the effect recovered the share (old − new)/(old − oracle).
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from racerl.data.load import load_given
from racerl.documents import read_json, write_json
from racerl.errors import ConfigError
from racerl.evaluate.evaluate import evaluate
from racerl.evaluate.outcome import METRICS
from racerl.gap.diagnose import MODEL, MODEL_BEFORE, VERDICT, gap
from racerl.run import Compose, RunFolder, is_complete
from racerl.train.train import train
from racerl.vehicle.load import load_vehicle

RESULT = "close.json"
SHOWN = ("mean_lap_s", "fastest_valid_lap_s", "e_off", "crash_share", "laps", "valid_laps")


def close(
    settings: Mapping[str, Any],
    out: Path,
    compose: Compose,
    on_progress: Callable[[float, str], None] = lambda share, what: None,
) -> dict[str, Any]:
    """Train and race the three policies; return what was written to close.json.

    Raises RunError for a run that is no finished diagnosis, ConfigError where nothing was named that could be added.
    """
    logs = [settings["logs"]] if isinstance(settings["logs"], str) else list(settings["logs"])
    finished = len(logs) == 1 and Path(logs[0]).is_dir()
    diagnosis = compose("gap", [f"logs={logs}", f"threads={settings['threads']}", *map(str, settings["gap"])])
    words = [*map(str, settings["train"]), f"threads={settings['threads']}"]
    # what cannot be read is told before anything is written
    load_vehicle(compose("train", [f"vehicle={settings['real']}", *words])["vehicle"])
    if finished:
        _verdict(Path(logs[0]))
    else:
        load_given(diagnosis)
    folder = RunFolder.start(out, "close", settings, threads=settings["threads"])
    found = Path(logs[0]) if finished else folder.path / "gap"
    if not finished and not is_complete(found):
        gap(diagnosis, found, lambda what, share: on_progress(0.0, what))
    verdict = _verdict(found)
    cars = {"old": found / MODEL_BEFORE, "new": found / MODEL, "oracle": settings["real"]}
    rows = {}
    for i, (kind, car) in enumerate(cars.items()):
        on_progress(i / 3, f"{kind}: training")
        trained, raced = folder.path / kind, folder.path / f"{kind}_race"
        if not is_complete(trained):
            train(compose("train", [f"vehicle={car}", *words]), trained)
        on_progress((i + 0.7) / 3, f"{kind}: racing")
        if not is_complete(raced):
            race = [f"run={trained}", f"vehicle={settings['real']}", f"laps={settings['laps']}"]
            evaluate(compose("evaluate", [*race, f"seeds={list(settings['seeds'])}"]), raced)
        rows[kind] = {key: read_json(raced / METRICS)[key] for key in SHOWN}
    facts = {
        "effects": [effect["name"] for effect in verdict["effects"]],
        "policies": rows,
        "recovered": recovered(*(rows[kind]["mean_lap_s"] for kind in cars)),
    }
    write_json(folder.path / RESULT, facts)
    folder.finish()
    return facts


def _verdict(run: Path) -> dict[str, Any]:
    """Return the verdict of a finished diagnosis; raise ConfigError where it holds no effect."""
    verdict = read_json(RunFolder.open_complete(run, "gap").path / VERDICT)
    if not verdict["effects"]:
        raise ConfigError(f"{run}: its verdict is {verdict['verdict']}, there is no effect to train with")
    return verdict


def recovered(old: float | None, new: float | None, oracle: float | None) -> float | None:
    """Return the share of the oracle's gain; None where a policy has no valid lap, or the oracle gains nothing."""
    if old is None or new is None or oracle is None or old <= oracle:
        return None
    return (old - new) / (old - oracle)
