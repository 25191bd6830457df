"""What a log could tell: which effects it would show at their usual size, which look alike in it, what to drive next.

The score test's matrix H over the effects' presences, nominal and initial-state sensitivities projected out, says both:
its diagonal is the χ² by which an effect of its usual size would show, its cosines how alike two effects look.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from racerl.data.load import load_measured
from racerl.data.log import Log, separate
from racerl.documents import write_json
from racerl.errors import LogError
from racerl.gap.checkpoint import Checkpoint
from racerl.gap.diagnose import FEWEST, check, cut, excitations, refit
from racerl.gap.progress import OnProgress, silent
from racerl.gap.score import Score, summed
from racerl.gap.screening import scores
from racerl.gap.verdict import alike
from racerl.record.record import Plan, table
from racerl.run import Compose, RunFolder
from racerl.vehicle.load import load_vehicle
from racerl.vehicle.rollout import on_threads

PLAN = "plan.json"
NEXT = 5  # manoeuvres that are proposed
SECONDS = 300  # of the programme, where no log is given


def plan(
    settings: Mapping[str, Any],
    out: Path,
    compose: Compose,
    on_progress: OnProgress = silent,
) -> dict[str, Any]:
    """Write plan.json about the logs of `settings`, or about the excitation programme if there are none.

    Raises LogError where the logs hold no stretch of driving.
    """
    check(settings)
    vehicle = load_vehicle(settings["vehicle"])
    given = load_measured(settings) if settings["logs"] else [programme(settings, compose)]
    logs, doubled = separate(given)
    evidence = cut(logs, settings)
    if not evidence:
        told = ", ".join(f"{log.name}: {log.seconds:.1f} s" for log in logs)
        least = f"{FEWEST} stretches of {settings['window']} samples above {settings['slowest']:g} m/s are needed"
        raise LogError(f"{told}; {least}; give longer logs, or more channels (racerl data shows them)")
    folder = RunFolder.start(out, "gap plan", settings, seed=settings["seed"], threads=settings["threads"])
    on_progress("refitting the vehicle", 0.1)
    checkpoint = Checkpoint.of(folder.path, settings, evidence)
    with on_threads(settings["threads"]):
        investigation = refit(evidence, logs, vehicle, settings, checkpoint)
    on_progress("what the log could tell", 0.8)
    facts = {
        "logs": [log.facts() for log in logs],
        "remarks": doubled,
        **telling(summed(scores(investigation, investigation.base).values())),
    }
    write_json(folder.path / PLAN, facts)
    folder.finish()
    Checkpoint.remove(folder.path)
    return facts


def programme(settings: Mapping[str, Any], compose: Compose) -> Log:
    """Return what the configured vehicle's sensors would show of the excitation programme."""
    drive = {**compose("record", [f"seconds={SECONDS}", f"seed={settings['seed']}"]), "vehicle": settings["vehicle"]}
    return Log.from_table("the excitation programme", table(Plan.of(drive).drive(), **drive["smoothing"]))


def telling(score: Score) -> dict[str, Any]:
    """Return what a score says of the data: χ² of every effect, pairs that look alike, what to drive next."""
    dark, cosines = score.hidden(), score.cosines()
    pairs: list[dict[str, Any]] = [
        {"effects": [score.names[i], score.names[j]], "cosine": float(cosines[i, j])}
        for i, j in np.argwhere(np.triu(alike(score))).tolist()
    ]
    pairs.sort(key=lambda row: -abs(row["cosine"]))
    wanted = [*dark, *(name for row in pairs for name in row["effects"])]
    return {
        "effects": {
            name: {"chi2": float(power), "shows": name not in dark}
            for name, power in zip(score.names, np.diag(score.H), strict=True)
        },
        "alike": pairs,
        "cosines": cosines.tolist(),
        "next": [
            {"drive": what, "for": names}
            for what, names in sorted(excitations(wanted).items(), key=lambda row: -len(row[1]))[:NEXT]
        ],
    }
