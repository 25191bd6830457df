"""The train stage: a policy for the configured race, examined on the way, the best one kept.

Writes into its run folder: `policy.safetensors` and `policy.json` (the best policy by evaluation), `progress.jsonl`
(one line per update, append-only) and `tensorboard/`; where the budget ends with a refinement, the policy before it
in `unrefined/`, too. `tracking` is no part of the run: it has no place in its configuration, and changes no number.
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from racerl import bounds
from racerl.assemble import build_vehicle, check_settings, choose_device, use_threads
from racerl.control.policy import FACTS, IMPROVEMENTS, UNREFINED, improved_by, load_policy, save_policy
from racerl.documents import read_json
from racerl.errors import ConfigError, Diverged, RunError
from racerl.evaluate.evaluate import learned
from racerl.registry import construct
from racerl.run import RunFolder, config_hash
from racerl.train.algorithms import Algorithm, create_algorithm
from racerl.train.ascent import Ascent
from racerl.train.checkpoint import FILE as TRAINING
from racerl.train.checkpoint import discard
from racerl.train.improve import FILE as IMPROVING
from racerl.train.improve import Improvement, improve
from racerl.train.refinement import Refinement
from racerl.train.session import Progress, Session, copy_progress
from racerl.train.trackers import create_tracker

KINDS = {"refinement": (Refinement, "evolution.yaml"), "ascent": (Ascent, "laptop.yaml")}  # and a budget that has one


def train(
    settings: Mapping[str, Any],
    out: Path,
    on_progress: Callable[[Progress], None] = lambda progress: None,
    begun: Path | None = None,
) -> dict[str, Any]:
    """Train a policy into the run folder `out`; return the facts that the manifest keeps.

    `begun`: a run that begins as this one does, whose policy before the improvement, with its seconds, is taken over.
    Raises RunError where the weights do not stay finite; the run is complete then, with the best policy from before.
    """
    bounds.whole("seed", settings["seed"], 0, 2**31 - 1)
    check_settings(settings)
    if not isinstance(settings.get("algo"), Mapping):
        raise ConfigError(f"algo = {settings.get('algo')}: a mapping with a name is expected, as conf/algo/ppo.yaml")
    use_threads(settings["threads"])
    algorithm = create_algorithm(settings["algo"])
    improvement = improvement_of(settings)
    tracker = create_tracker(settings.get("tracking"))
    own = {key: value for key, value in settings.items() if key != "tracking"}
    session = Session(own, out, choose_device(settings["device"]), on_progress, tracker)
    try:
        facts = algorithm.train(session) if improvement is None else _improved(session, algorithm, improvement, begun)
    except Diverged as error:
        if session.best is None:
            raise RunError(f"training {error}; no policy was examined before") from error
        facts = {"steps": session.best["steps"], "nan_cars": sum(race.faults for race in session.races)}
        facts["diverged"] = str(error)
        _finish(session, facts)
        raise RunError(f"training {error}; the best policy from before is kept in {out}") from error
    _finish(session, facts)
    return facts


def improvement_of(settings: Mapping[str, Any]) -> Improvement | None:
    """Return what a budget ends with; raise ConfigError for two of them, wrong settings, and a car without gradient."""
    budget = settings["budget"]
    if all(budget.get(key) is not None for key in KINDS):
        raise ConfigError(f"budget.{' and budget.'.join(KINDS)}: one of them is allowed; set the other to null")
    if not (key := improved_by(budget)):
        return None
    kind, example = KINDS[key]
    if kind is Ascent and (body := build_vehicle(settings).body):
        raise ConfigError(f"budget.{key}: needs a car's gradient; vehicle.body = {body} has none; use budget=evolution")
    if not isinstance(plan := budget[key], Mapping):
        raise ConfigError(f"budget.{key} = {plan}: settings as in conf/budget/{example} are expected, or null")
    found: Improvement = construct(kind, plan, f"budget.{key}")
    return found


def require_sound(run: Path) -> None:
    """Raise RunError for a finished training that has diverged, whose best policy is no result to compare with."""
    if diverged := RunFolder.open_complete(run, "train").manifest.get("diverged"):
        raise RunError(f"{run}: the training {diverged}")


def _finish(session: Session, facts: dict[str, Any]) -> None:
    """Mark the run complete; add to the facts what the policy is made of, and what the session knows."""
    if session.logger.name_to_value:  # of the last examination and update
        session.logger.dump(session.last.get("steps", facts["steps"]))
    facts |= {"made_of": learned(session.settings)}
    facts |= {"seconds": round(session.seconds, 1), "best": session.best}
    session.keep_failures()
    session.folder.finish(**facts)
    for name in (TRAINING, IMPROVING):  # only now: a run that is killed before goes on from them
        discard(session.out / name)


def beginning(settings: Mapping[str, Any]) -> str:
    """Return a hash of what decides a training before its improvement."""
    budget = {key: value for key, value in settings["budget"].items() if key not in IMPROVEMENTS}
    return config_hash({**settings, "budget": budget})


def _improved(
    session: Session, algorithm: Algorithm, improvement: Improvement, begun: Path | None = None
) -> dict[str, Any]:
    """Train, keep the policy as it is then, and improve it; a run that was interrupted on the way goes on there."""
    before = session.out / UNREFINED
    if begun or (before / FACTS).is_file():
        session.start()
        if begun and not (before / FACTS).is_file():
            _take_over(begun, session.out)
        facts = read_json(before / FACTS)
        done, session.best, began = facts["learned"], facts["evaluation"], facts["seconds"]
        session.earlier_seconds = began
    else:
        done, began = algorithm.train(session), session.seconds
        if session.logger.name_to_value:
            session.logger.dump(done["steps"])
        save_policy(load_policy(session.out), before, evaluation=session.best, learned=done, seconds=began)
    facts = improve(session, improvement, load_policy(before, session.device), done["steps"], began)
    return done | facts | {"nan_cars": done.get("nan_cars", 0) + facts["nan_cars"]}


def _take_over(begun: Path, out: Path) -> None:
    """Put into a run what another that begins alike had come to before its improvement."""
    facts, policy = read_json(begun / UNREFINED / FACTS), load_policy(begun / UNREFINED)
    copy_progress(begun, out, facts["learned"]["steps"])
    save_policy(policy, out, evaluation=facts["evaluation"])
    kept = {key: facts[key] for key in ("evaluation", "learned", "seconds")}
    save_policy(policy, out / UNREFINED, **kept)  # the last, for it says that all is there
