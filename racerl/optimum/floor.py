"""The floor under lap times: time-optimal laps found earlier, for the same car, track and limits."""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from racerl.env.actions import Action
from racerl.run import RunFolder, find_runs
from racerl.track.track import Track
from racerl.vehicle.parameter import values
from racerl.vehicle.vehicle import Vehicle


def problem_hash(vehicle: Vehicle, track: Track, action: Action) -> str:
    """Return what tells a lap problem from others: the car's values, the track's tables, the action's limits."""
    car = {name: float(value) for name, value in values(vehicle).items()}
    kinds = [type(part).__name__ for part in (vehicle.steering, vehicle.drive, action)]
    kinds += [vehicle.body] if vehicle.body else []
    tables = [table.round(6).tolist() for table in (track.x, track.y, track.width_left, track.width_right)]
    text = json.dumps([car, list(vehicle.states), kinds, asdict(action), tables], sort_keys=True)  # type: ignore[call-overload]
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def find_floor(problem: Any, runs: Sequence[RunFolder]) -> float | None:
    """Return the time in s of the newest optimum run of a problem among runs, oldest first; None when there is none."""
    times = [
        run.manifest["time_s"]
        for run in runs
        if run.manifest["stage"] == "optimum" and run.manifest.get("problem") == problem
    ]
    return float(times[-1]) if times and isinstance(times[-1], (int, float)) else None


def known_floor(problem: str) -> float | None:
    """Return the floor of a problem among the runs under `outputs`, where racerl is run."""
    return find_floor(problem, find_runs(Path("outputs")))


def gap(lap: float | None, floor: float | None) -> float | None:
    """Return by which share a lap is slower than the floor."""
    return None if lap is None or floor is None else lap / floor - 1.0
