"""Rivals of the policies, raced as they are: controllers that know the model, and the time-optimal lap as a bound.

A controller's command acts as late as its `delay` says, whatever its car does beside.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from racerl import bounds
from racerl.assemble import Car, build_action, build_timing, build_track, build_vehicle, use_threads
from racerl.control.controllers import Known, Rival, create_controller
from racerl.control.controllers.optimum import Optimum
from racerl.data.log import Log
from racerl.env.race import Race
from racerl.evaluate.against import FINDING, drive_against_floor
from racerl.evaluate.drive import Recorder
from racerl.evaluate.evaluate import build_evaluation_race, combine, seeds_of
from racerl.evaluate.outcome import write_outcome
from racerl.evaluate.recorded import follow
from racerl.optimum.floor import problem_hash
from racerl.registry import construct
from racerl.run import RunFolder

Settings = Mapping[str, Any]
TOUCHING = 1e-3  # m; a lap that touches the boundary goes beyond it between the points of its mesh
COMMANDS = ("steering_delay", "drive_delay")  # effects that make commands late


def race(
    settings: Settings, out: Path, on_progress: Callable[[float, str], None] = lambda share, remark: None
) -> dict[str, Any]:
    """Race the controller of `settings["controller"]`; return the metrics written into `out`."""
    seeds, laps = seeds_of(settings["seeds"]), bounds.whole("laps", settings["laps"], 1, 10_000)
    use_threads(settings["threads"])
    car = construct(Car, settings["car"], "car")
    design = create_controller(settings["controller"])
    if isinstance(design, Optimum):
        return _bound(design, settings, out, car, lambda share: on_progress(share, FINDING))
    on_progress(0.0, "getting ready")
    field, controller = prepare(settings, car)
    folder = RunFolder.start(out, "evaluate", settings, seed=seeds, threads=settings["threads"])
    recorder = Recorder(field, seeds)
    vehicle = build_vehicle(_world(settings, car))  # as it is without the controller's delay
    problem = problem_hash(vehicle, field.track, field.action)
    driven, floor = drive_against_floor(field, vehicle, controller, laps, recorder, on_progress)
    metrics = write_outcome(
        folder,
        driven,
        seeds,
        recorder.log(),
        field.track,
        label=controller.name,
        car=car.name,
        controller=controller.name,
        floor=floor,
        race=field,
        laps_per_seed=laps,
        **controller.facts,
    )
    folder.finish(nan_cars=field.faults, problem=problem)
    return metrics


def prepare(settings: Settings, car: Car) -> tuple[Race, Rival]:
    """Return the race in a car and the controller that is ready to drive it."""
    design = create_controller(settings["controller"])
    world = _world(settings, car)
    world["vehicle"] = later(world["vehicle"], design.delay)
    field = build_evaluation_race(world, seeds_of(settings["seeds"]), torch.device("cpu"), car.estimate)
    return field, design.prepare(Known(build_vehicle(settings), field.track, field.action, field.timing))


def _world(settings: Settings, car: Car) -> dict[str, Any]:
    """Return the settings of the race that is driven in a car."""
    return combine({**settings, "obs": {"name": "progress"}}, {"sim": settings["sim"]}, car)


def later(vehicle: Settings, delay: float) -> dict[str, Any]:
    """Return the settings of a vehicle whose commands act later than its own by `delay` seconds."""
    effects = {name: dict(effect or {}) for name, effect in (vehicle.get("effects") or {}).items()}
    if delay:
        for name in COMMANDS:
            effects[name] = {"delay": effects.get(name, {}).get("delay", 0.0) + delay}
    return {**vehicle, "effects": effects}


def _bound(
    design: Optimum, settings: Settings, out: Path, car: Car, on_share: Callable[[float], None]
) -> dict[str, Any]:
    """Score the time-optimal lap of the car itself."""
    world = _world(settings, car)
    known = Known(build_vehicle(world), build_track(world), build_action(world), build_timing(world))
    log = Log.from_table("optimum", design.lap(known, on_share))
    folder = RunFolder.start(out, "evaluate", settings, threads=settings["threads"])
    laps, driven = follow(known.track, [log])
    lap = laps[0]
    if lap.max_off_track_m < TOUCHING:
        lap = replace(lap, e_off=0.0, max_off_track_m=0.0)
    only = driven[driven["lap"] == lap.number]
    metrics = write_outcome(
        folder,
        [lap],
        [0],
        only,
        known.track,
        label="time-optimal lap",
        car=car.name,
        controller="optimum",
        floor=lap.time_s,
        laps_per_seed=1,
    )
    folder.finish(problem=problem_hash(known.vehicle, known.track, known.action))
    return metrics
