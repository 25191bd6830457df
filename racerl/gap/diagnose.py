"""`racerl gap`: locate, name, add, prove. Each step leaves its own JSON; an interrupted run goes on behind its fits."""

import fnmatch
import re
import time
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from racerl import bounds
from racerl.data.inspect import inspect, lines_of
from racerl.data.load import load_measured
from racerl.data.log import POSE, Log, separate
from racerl.documents import conf_folder, write_json, write_text
from racerl.estimation.unknowns import HELD, choose_unknowns
from racerl.gap import residual
from racerl.gap.catalogue import of_the_world, starts
from racerl.gap.checkpoint import Checkpoint
from racerl.gap.decision import Decision
from racerl.gap.evidence import COMMANDS, Evidence, channels_of
from racerl.gap.fitted_model import COG, FittedModel
from racerl.gap.hypotheses import Hypothesis, calibrated, calibrated_least, credible, hypotheses
from racerl.gap.investigation import Investigation, investigate
from racerl.gap.locate import locate
from racerl.gap.naming import name_effects
from racerl.gap.numbers import as_configured, wrong_numbers
from racerl.gap.progress import OnProgress, silent, within
from racerl.gap.prove import prove
from racerl.gap.shapes import in_order, said_of, shapes_of
from racerl.gap.stage import CHAIN, TYRES, Stage, stages
from racerl.gap.uncertainty import FAR, deviations, intervals, moved, possible_cars
from racerl.gap.verdict import CLAIMS, Verdict, judge, proved, separable
from racerl.identify.document import write_model
from racerl.identify.uncertainty import IDENTIFIED
from racerl.run import RunFolder
from racerl.vehicle import catalogue
from racerl.vehicle.cars import write_cars
from racerl.vehicle.load import load_vehicle, vehicle_document
from racerl.vehicle.parameter import specifications, values
from racerl.vehicle.rollout import on_threads
from racerl.vehicle.vehicle import Vehicle

LOCATE, NAME, PROOF, VERDICT, MODEL = "locate.json", "name.json", "prove.json", "verdict.json", "model.yaml"
MODEL_BEFORE = "model_before.yaml"  # refitted, without the effects found
RESIDUAL, RESIDUAL_MODEL = "residual.json", "model_residual.yaml"
LISTED = {"hold": HELD, "without": "a list of effects is expected, for instance without=[yaw_damping]"}
FEWEST = 20  # windows of a stage, below which it is left out
PROGRAMME = (
    "ten runs or more with step steers of three sizes, slow ramps to full lock, circles of two radii at two speeds "
    "both ways round, speed steps up and down, and coast-downs, at up to the tyres' limit"
)
# shares of the work: where each step begins, and where naming and counting end
NAMING, COUNTING, PROVING, LEARNING = (0.06, 0.7), (0.7, 0.76), 0.78, 0.8


def gap(settings: Mapping[str, Any], out: Path, on_progress: OnProgress = silent) -> dict[str, Any]:
    """Diagnose the logs of `settings` and write the verdict, the vehicle and each step's findings into `out`.

    Raises ConfigError, VehicleError, LogError or RunError; a log that cannot tell gives a verdict, not an error.
    """
    check(settings)
    with on_threads(settings["threads"]):
        return _diagnosed(settings, out, on_progress)


def _diagnosed(settings: Mapping[str, Any], out: Path, on_progress: OnProgress) -> dict[str, Any]:
    began = time.perf_counter()
    vehicle = load_vehicle(settings["vehicle"])
    logs, doubled = separate(load_measured(settings))
    evidence = cut(logs, settings)
    folder = RunFolder.start(out, "gap", settings, seed=settings["seed"], threads=settings["threads"])
    on_progress("refitting the vehicle", 0.0)
    inspected = [inspect(log, float(vehicle.wheelbase)) for log in logs]
    told: dict[str, Any] = {
        "logs": [log.facts() for log in logs],
        "remarks": [*doubled, *lines_of(inspected, "warnings")],
        "contradictions": lines_of(inspected, "contradictions"),
        "untestable": _untestable(evidence, channels_of(logs)),
    }
    if not evidence:
        facts = _silent(logs) | told
        write_text(folder.path / MODEL, yaml.safe_dump(vehicle_document(settings["vehicle"], {}, "wheel_speed")))
    else:
        checkpoint = Checkpoint.of(folder.path, settings, evidence)
        investigation = refit(evidence, logs, vehicle, settings, checkpoint)
        told["remarks"] += investigation.nominal.doubts()
        whole = chain(logs, settings)
        missing = [name for name in COMMANDS if name not in channels_of(logs)]
        facts, found, investigation = _steps(investigation, whole, settings, folder.path, told, missing, on_progress)
        facts["remarks"] += _shapes_told(settings["vehicle"], found)
        _write_vehicle(folder.path / MODEL, settings, facts, investigation, found)
        if found.problem.names:
            cars = possible_cars(investigation, found, settings["seed"])
            write_cars(folder.path, found.vehicle, found.problem.names, cars)
        _write_vehicle(folder.path / MODEL_BEFORE, settings, facts, investigation, investigation.base)
    write_json(folder.path / VERDICT, facts)
    folder.finish(seconds=round(time.perf_counter() - began, 2))
    Checkpoint.remove(folder.path)
    return facts


def check(settings: Mapping[str, Any]) -> None:
    """Raise ConfigError for settings of the wrong kind or out of range."""
    whole = {"window": (20, 1000), "folds": (2, 20), "seed": (0, 2**31), "threads": (1, 256)}
    for key, (low, high) in whole.items():
        bounds.whole(key, settings[key], low, high)
    bounds.number("slowest", settings["slowest"], 0.0, 50.0, "m/s")
    _listed(settings, "hold")
    for name in _listed(settings, "without"):
        catalogue.entry(name)


def _listed(settings: Mapping[str, Any], key: str) -> list[str]:
    return bounds.words(key, settings[key], LISTED[key])


def cut(logs: Sequence[Log], settings: Mapping[str, Any]) -> dict[str, Evidence]:
    """Return the windows of every stage that the logs have the channels and the length for."""
    chain = stages(channels_of(logs))
    found = [_windows(logs, stage, settings) for stage in chain]
    return {each.stage.name: each for each in found if each is not None}


def _windows(logs: Sequence[Log], stage: Stage, settings: Mapping[str, Any]) -> Evidence | None:
    """Return a stage's windows; None where there are too few."""
    found = Evidence.of(logs, stage, settings["window"], settings["slowest"])
    return found if found is not None and len(found.start) >= FEWEST else None


def chain(logs: Sequence[Log], settings: Mapping[str, Any]) -> Evidence | None:
    """Return the windows of the whole chain; None where it is no longer than the chassis, or too short."""
    return _windows(logs, CHAIN, settings) if {"delta", "omega"} <= channels_of(logs) else None


def refit(
    evidence: Mapping[str, Evidence],
    logs: Sequence[Log],
    vehicle: Vehicle,
    settings: Mapping[str, Any],
    checkpoint: Checkpoint,
) -> Investigation:
    """Return the evidence with the vehicle refitted to it, and the effects that it may lack."""
    unknowns = choose_unknowns(vehicle, settings["priors"], settings["hold"], vehicle)
    without = {*_listed(settings, "without"), *vehicle.effects}
    limits = {name: (value, value) for name, value in _held(vehicle, _listed(settings, "hold"))}
    # one shift of all on-board channels is one of the motion capture, the other way; whichever is late has the name
    if set(POSE) <= channels_of(logs):
        limits["effects.command_timestamp_offset.latency"] = (0.0, 0.2)
    else:
        without |= set(_unseen())
    if "l_f" in unknowns.names and COG not in without:  # further off has a name
        at = unknowns.names.index("l_f")
        weighed, deviation = float(unknowns.start[at]), float(unknowns.sigma[at])
        limits["l_f"] = weighed - FAR * deviation, weighed + FAR * deviation
    folder = conf_folder() / "vehicle" / "effect"
    candidates = {name: starts(name, folder) for name in catalogue.names() if name not in without}
    return investigate(
        evidence,
        vehicle,
        unknowns,
        candidates,
        limits=limits,
        folds=settings["folds"],
        threads=settings["threads"],
        seed=settings["seed"],
        checkpoint=checkpoint,
    )


def _held(vehicle: Vehicle, hold: Sequence[str]) -> list[tuple[str, float]]:
    """Return the parameters that stay as they are, with their values."""
    table = values(vehicle)
    return [(name, float(table[name])) for pattern in hold for name in fnmatch.filter(table, pattern)]


def _steps(
    plain: Investigation,
    whole: Evidence | None,
    settings: Mapping[str, Any],
    folder: Path,
    told: Mapping[str, Any],
    missing: Sequence[str],
    on_progress: OnProgress,
) -> tuple[dict[str, Any], FittedModel, Investigation]:
    """Carry out the four steps; return the verdict's document, the vehicle with what was named, and by which refit."""
    on_progress("locate", NAMING[0] / 2.0)
    located = locate(plain, whole)
    write_json(folder / LOCATE, located)
    decision = name_effects(plain, within(lambda what, share: on_progress(f"name: {what}", share), *NAMING))
    investigation = decision.investigation
    proof = prove(investigation, decision.found)
    verdict = proved(judge(investigation, decision), proof["gap"])
    chosen = decision.found if verdict.kind in CLAIMS else investigation.base
    numbers = wrong_numbers(investigation, chosen, within(on_progress, *COUNTING))
    found = numbers.vehicle
    shown = found if verdict.kind in CLAIMS else decision.found
    on_progress("add", COUNTING[1])
    told_effects = _named(decision, verdict, shown, intervals(investigation, shown))
    write_json(folder / NAME, told_effects)
    on_progress("prove", PROVING)
    if shown is not decision.found:
        proof = prove(investigation, shown)
    write_json(folder / PROOF, proof)
    facts = {
        "verdict": verdict.kind,
        "reason": verdict.reason,
        "configured": as_configured(investigation, numbers, proof["gap"]["unfitted"]),
        "effects": told_effects["effects"] if verdict.kind in CLAIMS else [],
        "helped": told_effects["effects"] if verdict.kind not in CLAIMS else [],
        "ambiguous_with": list(verdict.rivals),
        "hypotheses": _told(hypotheses(decision.features, calibrated())),
        "next_manoeuvre": next_manoeuvre(verdict, missing if _one(decision, verdict) else ()),
        "ranking": told_effects["ranking"],
        "where": located["where"],
        "moved": moved(investigation),
        "gap": proof["gap"],
        "worse": proof["worse"],
        "blind_to": list(verdict.blind),
        "separable": list(separable(decision.score)),
        "residual": None,
        **told,
    }
    if verdict.kind == "unknown" and TYRES in investigation.evidence:
        facts["residual"] = _residual(investigation, settings, folder, told, within(on_progress, LEARNING, 1.0))
    return facts, found, investigation


def _residual(
    investigation: Investigation,
    settings: Mapping[str, Any],
    folder: Path,
    told: Mapping[str, Any],
    on_progress: OnProgress,
) -> dict[str, Any] | None:
    """Write the vehicle with a learned residual if that helps; return what it explains."""
    facts, found = residual.learn(investigation, on_progress)
    write_json(folder / RESIDUAL, facts)
    if not facts["effects"]:
        return None
    _write_vehicle(folder / RESIDUAL_MODEL, settings, told, investigation, found)
    kept = [step for step in facts["steps"] if step["kept"]]
    return {
        "name": " + ".join(facts["effects"]),
        "explained": kept[-1]["explained"],
        "terms": list(kept[0]["weights"]),
        "vehicle": RESIDUAL_MODEL,
    }


def _told(found: Sequence[Hypothesis]) -> list[dict[str, Any]]:
    """Return hypotheses as they are told, and which of them are in the set that holds the truth in 95 % of cars."""
    count = len(credible(found, calibrated_least()))
    return [
        {"names": list(each.names), "probability": each.probability, "in_set": number < count}
        for number, each in enumerate(found)
    ]


def _named(
    decision: Decision, verdict: Verdict, found: FittedModel, ranges: Mapping[str, tuple[float, float, float]]
) -> dict[str, Any]:
    units = {name: unit.unit for name, unit in specifications(found.vehicle).items()}
    return {
        "effects": [
            {
                "name": name,
                "parameters": {
                    key.rpartition(".")[2]: {"value": value, "unit": units[key], "ci95": [low, high]}
                    for key, (value, low, high) in ranges.items()
                    if key.startswith(f"effects.{name}.")
                },
                "explained": float(np.clip(rows[0].worth, 0.0, 1.0)),
                "stability": rows[0].leads,
            }
            for name, rows in decision.kept.items()
        ],
        "ranking": [
            {"name": row.name, "heldout_gain": row.gain, "p": row.p, "explained": row.explained, "behind": row.behind}
            for row in (decision.rounds[0] if decision.rounds else [])
        ],
        "rounds": decision.features,
        "excess": decision.excess,
        "blind": list(verdict.blind),
    }


def _one(decision: Decision, verdict: Verdict) -> bool:
    """Return whether a rival is one with an effect, for want of a stage that tells them apart."""
    return any(decision.score.one(effect, rival) for effect in verdict.effects for rival in verdict.rivals)


def next_manoeuvre(verdict: Verdict, missing: Sequence[str] = ()) -> str:
    """Return what to drive, and which channels to log with it, so that the next log decides; else nothing."""
    if verdict.kind == "ambiguous":
        channels = [f"any, with {' and '.join(missing)} in the log"] if missing else []
        return "; ".join([*channels, *excitations((*verdict.effects, *verdict.rivals))])
    if verdict.kind == "under_excited":
        return PROGRAMME
    return ""


def excitations(names: Iterable[str]) -> dict[str, list[str]]:
    """Return what to drive for some effects, with the effects that each manoeuvre is for."""
    found: dict[str, list[str]] = {}
    for name in dict.fromkeys(names):
        for what in re.split(r"[,;] ", catalogue.entry(name).aspects["Excited by"].rstrip(".")):
            found.setdefault(what, []).append(name)
    return found


def _shapes_told(given: Mapping[str, Any], found: FittedModel) -> list[str]:
    """Return what the refit found the vehicle to be beside its parameters, in words; what was configured is known."""
    new = [name for name in shapes_of(found) if name not in (given.get("effects") or {})]
    return [f"the vehicle fits better with {said_of(name, found)}: {MODEL} has it ({name})" for name in new]


def _silent(logs: Sequence[Log]) -> dict[str, Any]:
    """Return the verdict on logs that hold no stretch of driving to look at."""
    fewer = f"{sum(log.seconds for log in logs):.1f} s of log have fewer than {FEWEST} windows of driving"
    return {
        "verdict": "under_excited",
        "configured": {"error": None, "explained": 0.0, "changes": [], "rest": 0.0},
        "reason": f"{fewer} with the channels that a stage needs",
        "effects": [],
        "helped": [],
        "ambiguous_with": [],
        "hypotheses": [],
        "next_manoeuvre": PROGRAMME,
        "ranking": [],
        "where": [],
        "moved": [],
        "gap": None,
        "worse": [],
        "blind_to": list(catalogue.names()),
        "separable": [],
        "residual": None,
    }


def _unseen() -> list[str]:
    """Return the effects that only a pose can show."""
    return ["pose_latency", *(name for name in catalogue.names() if of_the_world(name))]


def _untestable(evidence: Mapping[str, Evidence], channels: Collection[str]) -> dict[str, str]:
    """Return the stages, and the effects, that the logs' channels or their shortness leave untested."""
    unseen = [] if set(POSE) <= set(channels) else _unseen()
    return dict.fromkeys(unseen, f"needs {', '.join(POSE)}") | {
        stage.name: f"needs {', '.join(stage.needed)} and {_any_of(stage.outputs)} over {FEWEST} windows or more"
        for stage in stages(channels)
        if stage.name not in evidence
    }


def _any_of(channels: Sequence[str]) -> str:
    return channels[0] if len(channels) == 1 else f"one of {', '.join(channels)}"


def _write_vehicle(
    path: Path, settings: Mapping[str, Any], facts: Mapping[str, Any], investigation: Investigation, found: FittedModel
) -> None:
    """Write a fitted vehicle with the effects that were named."""
    units, sure = specifications(found.vehicle), deviations(investigation, found)
    parameters = {
        name: {
            "ci95": [low, high],
            "identified": 1.96 * sure[name] < IDENTIFIED * abs(value),
            "unit": units[name].unit,
        }
        for name, (value, low, high) in intervals(investigation, found).items()
    }
    configured = values(investigation.vehicle)
    for row in facts.get("configured", {}).get("changes", []):  # a number that a refit around it leaves as it is
        name = row["parameter"]
        if name not in parameters and found.theta[name] != float(configured[name]):
            parameters[name] = {"ci95": row["ci95"], "identified": True, "unit": units[name].unit}
    added = {
        name: {key.rpartition(".")[2]: found.theta[key] for key in found.theta if key.startswith(f"effects.{name}.")}
        for name in (*sorted(found.effects), *shapes_of(found))
    }
    given = settings["vehicle"]
    vehicle = {**given, "effects": in_order({**(given.get("effects") or {}), **added})}
    changes = {name: found.theta[name] for name in parameters}
    write_model(path, vehicle, changes, {"logs": facts["logs"], "parameters": parameters}, "gap")
