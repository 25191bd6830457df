"""The evaluate stage: flying laps of a trained policy in a car, scored and recorded; or those of a recorded drive.

Reads a finished training run, or a drive log; `racerl.evaluate.outcome` says what is written.
"""

import logging
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import torch

from racerl import bounds
from racerl.assemble import Car, build_race, check_settings, choose_device, files_read, unlimited, use_threads
from racerl.control.policy import FACTS, UNREFINED, improved_by, load_policy
from racerl.data.layout import read_layout
from racerl.documents import read_json
from racerl.env.race import Race
from racerl.env.randomize import Randomization
from racerl.env.termination import CRASH_DISTANCE, Crash
from racerl.errors import ConfigError, PolicyError
from racerl.evaluate.against import drive_against_floor
from racerl.evaluate.drive import Recorder
from racerl.evaluate.outcome import write_outcome
from racerl.evaluate.recorded import follow, read_recorded
from racerl.optimum.floor import problem_hash
from racerl.paper import PAPER
from racerl.registry import construct
from racerl.run import MANIFEST, RunFolder

log = logging.getLogger(__name__)

ELSEWHERE = 0.5  # share of a drive off the track, beyond which it was on another
REFINED = {"": "", "refinement": " refined by evolution", "ascent": " refined"}
# in another world than it was learned in
ONWARD = {"refinement": ", refined on by evolution", "ascent": ", refined on"}
OVERRIDABLE = ("vehicle", "track", "sim", "dr")


def evaluate(
    settings: Mapping[str, Any], out: Path, on_progress: Callable[[float, str], None] = lambda share, remark: None
) -> dict[str, Any]:
    """Evaluate the policy, or score the drive log, of `settings["run"]`; return the metrics written into `out`."""
    read_layout(settings["data"])  # of a log; its keys are told from others here, whatever is scored
    if Path(str(settings["run"])).is_file() or str(settings["run"]).startswith(PAPER):
        return _evaluate_log(settings, out)
    run = Path(str(settings["run"]))
    origin = origin_of(run)
    seeds, laps = seeds_of(settings["seeds"]), bounds.whole("laps", settings["laps"], 1, 10_000)
    use_threads(settings["threads"])
    name = label(origin.settings)
    car = construct(Car, settings["car"], "car")
    race_settings = combine(origin.settings, settings, car)
    _tell_of_changes(origin.training, race_settings)
    device = choose_device(settings["device"])
    policy = load_policy(run, device)
    # the policy knows what it sees and does, in which scale
    race_settings |= {"obs": policy.observation, "action": policy.action}
    race = build_evaluation_race(race_settings, seeds, device, car.estimate)
    if race.observation.size != policy.sizes[0]:
        raise PolicyError(
            f"{run}: the policy reads {policy.sizes[0]} numbers, the observation has {race.observation.size}"
        )

    folder = RunFolder.start(out, "evaluate", settings, seed=seeds, threads=settings["threads"], device=str(device))
    recorder = Recorder(race, seeds)
    problem = problem_hash(race.vehicle, race.track, race.action)
    driven, floor = drive_against_floor(race, race.vehicle, policy, laps, recorder, on_progress)
    metrics = write_outcome(
        folder,
        driven,
        seeds,
        recorder.log(),
        race.track,
        label=name,
        car=car.name,
        controller=policy.name,
        floor=floor,
        race=race,
        run=str(settings["run"]),
        run_id=origin.identity,
        trained=origin.course,
    )
    folder.finish(train_run_id=origin.identity, nan_cars=race.faults, problem=problem)
    return metrics


class Origin(NamedTuple):
    """Where a policy comes from: its training, settings that say what it has been through, its steps and seconds."""

    training: RunFolder
    settings: dict[str, Any]
    course: dict[str, Any]
    identity: str  # of the policy: the run's, with what it was before the run's refinement apart


def origin_of(run: Path) -> Origin:
    """Return where a policy comes from; `run` is a finished training, or its `unrefined/`."""
    before = run.name == UNREFINED and not (run / MANIFEST).exists()
    training = RunFolder.open_complete(run.parent if before else run, "train")
    settings, identity = training.settings(), str(training.manifest["run_id"])
    check_settings(settings)
    if not before:
        return Origin(training, settings, {key: training.manifest.get(key) for key in ("steps", "seconds")}, identity)
    facts = read_json(run / FACTS)
    learned = facts.get("learned")
    steps = learned.get("steps") if isinstance(learned, Mapping) else None
    course = {"steps": steps, "seconds": facts.get("seconds")}
    return Origin(training, {**settings, "budget": None}, course, f"{identity}/{UNREFINED}")


def _tell_of_changes(training: RunFolder, settings: Mapping[str, Any]) -> None:
    """Warn of files that a race reads and that were others when the policy was trained."""
    if not isinstance(known := training.manifest.get("files"), Mapping):
        return
    for path, now in files_read(settings).items():
        if known.get(path, now) != now:
            log.warning("%s has changed since %s was trained; it is raced in what it is now", path, training.path)


def _evaluate_log(settings: Mapping[str, Any], out: Path) -> dict[str, Any]:
    track, logs = read_recorded(settings)
    folder = RunFolder.start(out, "evaluate", settings)
    driven, drive = follow(track, logs)
    if (away := float((drive["margin"] < -CRASH_DISTANCE).mean())) > ELSEWHERE:
        told = "%s is off the track %s in %.0f %% of its samples: is it another track, or another origin of the poses?"
        log.warning(told, settings["run"], track.name, 100 * away)
    cars = range(1 + max((lap.car for lap in driven), default=0))
    label = logs[0].name if str(settings["run"]).startswith(PAPER) else f"log {logs[0].name}"
    metrics = write_outcome(folder, driven, cars, drive, track, label=label, car="recorded", controller="recorded")
    folder.finish()
    return metrics


def combine(trained: Mapping[str, Any], settings: Mapping[str, Any], car: Car) -> dict[str, Any]:
    """Return the settings of the race: those of the training run, in the car and with the overrides given here."""
    combined = dict(trained)
    for group in OVERRIDABLE:
        if settings.get(group) is not None:
            combined[group] = settings[group]
    if settings.get("dr") is None:  # a race is driven in one car, which may change from lap to lap
        combined["dr"] = {"sigma": 0.0, "parameters": [], **car.drift, "each_lap": True}
    combined["vehicle"] = car.wear(combined["vehicle"])
    # the car that is driven has actuators, whatever the policy was trained with, unless `sim` is asked for
    actuators = combined["sim"]["actuators"] if settings.get("sim") else car.actuators
    step = combined["sim"]["step"]  # a motor needs its small one in any car
    step = step if car.step is None else min(step, car.step)
    combined["sim"] = {**combined["sim"], "actuators": actuators, "step": step}
    return unlimited(combined)


def build_evaluation_race(
    settings: Mapping[str, Any], seeds: list[int], device: torch.device, noise: Mapping[str, float] | None = None
) -> Race:
    """Build a race with one car per seed, which ends an episode only at a crash."""
    return build_race(settings, cars=len(seeds), seeds=seeds, device=device, termination=Crash(), noise=noise)


def label(settings: Mapping[str, Any]) -> str:
    """Return a short name of a policy from what it was trained with."""
    parts = [settings["obs"]["name"], settings["action"]["name"]]
    dr = construct(Randomization, settings["dr"], "dr")
    kind = dr.parameters[0] if len(dr.parameters) == 1 else "all" if dr.parameters else ""
    spread = ["identified cars" if dr.cars else "", f"{kind} σ = {dr.sigma:g}" if dr.sigma else ""]
    parts += spread if any(spread) else ["no randomization"]
    if dr.actions or any(dr.estimate.values()):
        parts.append("noise")
    if not settings["sim"]["actuators"]:
        parts.append("no actuator model")
    parts.append(learned(settings))
    return ", ".join(part.replace("_", " ") for part in parts if part)


def learned(settings: Mapping[str, Any]) -> str:
    """Return by what a policy was learned: "PPO refined", say."""
    algorithm, budget = settings.get("algo"), settings.get("budget")
    if not isinstance(algorithm, Mapping) or not isinstance(name := algorithm.get("name"), str):
        return ""
    refined = improved_by(budget) if isinstance(budget, Mapping) else ""
    if name == "trained":
        before = str(algorithm.get("learned"))
        known = next((words for words in ONWARD.values() if before.endswith(words)), "")
        return before.removesuffix(known) + ONWARD[refined] if refined else before
    by = ("PPO" if name == "ppo" else name) + (" drifting first" if algorithm.get("drift") else "")
    by = ("recurrent " if algorithm.get("recurrent") else "") + by
    return by + (" with a privileged critic" if algorithm.get("privileged") else "") + REFINED[refined]


def seeds_of(value: Any) -> list[int]:
    """Return the seeds of starts, of which one may be given alone; raise ConfigError for anything else."""
    seeds = bounds.wholes("seeds", [value] if isinstance(value, int) else value, 0, 2**31 - 1)
    if not seeds:
        raise ConfigError("seeds = []: one at least is needed")
    return seeds
