"""From a resolved configuration, a plain mapping, to the objects of the world."""

import ctypes
import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch

from racerl import bounds
from racerl.documents import conf_folder as conf_folder
from racerl.documents import content_hash
from racerl.env.actions import Action, create_action
from racerl.env.observations import create_observation, settings_of
from racerl.env.race import Race, Timing
from racerl.env.races import SEED_STEP, Races
from racerl.env.randomize import Randomization
from racerl.env.sensing import check_estimate
from racerl.env.termination import OffTrack, Termination
from racerl.errors import ConfigError
from racerl.registry import construct
from racerl.track.folder import OTHERS
from racerl.track.load import load_track
from racerl.track.track import Track
from racerl.vehicle.cars import CARS
from racerl.vehicle.load import load_vehicle, vehicle_document
from racerl.vehicle.vehicle import Vehicle

Settings = Mapping[str, Any]

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3  # of glibc's mallopt
KEPT_BLOCK, KEPT_TOTAL = 32 << 20, 256 << 20  # bytes: blocks up to this size, and this much free memory, are kept

SIMS = {"wheel_speed": "default", "motor_current": "motor_current"}  # conf/sim with its drive and the step it needs

# what a resolved configuration, perhaps one that a stranger's run folder holds, must have
NEEDED: dict[str, tuple[str, ...]] = {
    "vehicle": (),
    "track": ("file",),
    "sim": ("dt", "step", "max_steps", "drive", "actuators"),
    "obs": ("name",),
    "action": ("name",),
    "dr": ("sigma", "parameters"),
}


@dataclass(frozen=True)
class Car:
    """What is driven and measured, `conf/car/*.yaml`: the model itself, or a car that does what the model does not."""

    name: str
    actuators: bool = True
    body: str = ""  # of racerl.vehicle.bodies: another's equations in place of the single-track car's
    step: float | None = None  # s, of the Runge–Kutta steps; that of `sim` where it is None
    vehicle: Mapping[str, Any] = field(
        default_factory=dict
    )  # what is driven in place of `model`, with effects of its own
    model: Mapping[str, Any] = field(default_factory=dict)  # the vehicle that `vehicle` was measured beside
    effects: Mapping[str, Mapping[str, float]] = field(default_factory=dict)  # added to the vehicle's own
    drift: Mapping[str, Any] = field(default_factory=dict)  # a randomization, of what changes from lap to lap
    grip: float = 1.0  # of the floor, as a share of the vehicle's friction
    estimate: Mapping[str, float] = field(default_factory=dict)  # noise of what the driver sees, deviation per state
    sensors: Mapping[str, float] = field(default_factory=dict)  # noise of what is recorded

    def __post_init__(self) -> None:
        check_estimate("car.estimate", self.estimate)
        bounds.number("car.grip", self.grip, 0.1, 10.0)

    def has_actuators(self, sim: Settings) -> bool:
        """Return whether commands act through actuators; raise ConfigError for a motor's current without any."""
        there = bool(sim["actuators"]) and self.actuators
        if sim["drive"] == "motor_current" and not there:
            raise ConfigError(
                "sim.drive = motor_current: a car without actuators has no motor; give sim.actuators=true"
            )
        return there

    def wear(self, vehicle: Settings) -> dict[str, Any]:
        """Return the settings of the vehicle that this car is; any but `model` keeps its numbers."""
        effects = {**(vehicle.get("effects") or {}), **self.effects}
        if self.model and _numbers(vehicle) == _numbers(self.model):
            vehicle, effects = self.vehicle, {**(self.vehicle.get("effects") or {}), **effects}
        floor = {}
        if self.grip != 1.0:
            floor["friction"] = self.grip * vehicle_document(vehicle, {}, "wheel_speed").get("friction", 1.0)
        body = {"body": self.body} if self.body else {}
        return {**vehicle, **floor, **body, "effects": effects}


def _numbers(vehicle: Settings) -> dict[str, Any]:
    return {key: value for key, value in vehicle.items() if key != "effects"}


def check_settings(settings: Settings) -> None:
    """Raise ConfigError when a section or one of its keys is missing."""
    for section, keys in NEEDED.items():
        content = settings.get(section)
        if not isinstance(content, Mapping):
            raise ConfigError(f"config: section '{section}' is missing or no mapping; compose it with racerl train")
        for key in keys:
            if key not in content:
                raise ConfigError(f"config: {section}.{key} is missing; give it a value")
        for key in ("file", "name"):
            if key in content and (not isinstance(content[key], str) or not content[key] or "\0" in content[key]):
                raise ConfigError(f"config: {section}.{key} = {content[key]!r}: a word is expected")
    others = settings["track"].get(OTHERS, [])
    if not isinstance(others, list) or not all(isinstance(each, Mapping) and each.get("file") for each in others):
        raise ConfigError(f"config: track.{OTHERS} = {others!r}: a list of tracks, each with a file, is expected")
    effects = settings["vehicle"].get("effects")
    if not isinstance(effects, Mapping | None):
        raise ConfigError(f"config: vehicle.effects = {effects!r}: a mapping from effects to their numbers is expected")


def files_read(settings: Settings) -> dict[str, str]:
    """Return hashes of the user's files that settings name, by path: a vehicle, tracks, cars to draw from."""
    others = [each for each in settings["track"].get(OTHERS, []) if isinstance(each, Mapping)]
    named = [each.get("file") for each in (settings["vehicle"], settings["track"], *others)]
    paths = [Path(each) for each in named if isinstance(each, str) and each]
    if isinstance(cars := settings["dr"].get("cars"), str):
        paths.append(Path(cars) / CARS)
    found = {}
    for path in paths:
        with suppress(OSError, ValueError):  # it is told where the file is read
            if path.is_file():  # and no device
                found[str(path)] = content_hash(path)
    return found


def use_threads(threads: Any) -> None:
    """Let torch compute with this many threads; raise ConfigError when it is no sensible number."""
    torch.set_num_threads(bounds.whole("threads", threads, 1, 256))
    _keep_memory()


def _keep_memory() -> None:
    """Let the process keep what torch frees: pages asked for anew at every step cost more time than the step."""
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None) if os.name == "posix" else None
    if mallopt is not None:  # glibc
        mallopt(M_MMAP_THRESHOLD, KEPT_BLOCK)
        mallopt(M_TRIM_THRESHOLD, KEPT_TOTAL)


def build_vehicle(settings: Settings) -> Vehicle:
    """Build the car of `vehicle`, with the drive mode and actuators of `sim`."""
    sim = settings["sim"]
    return load_vehicle(settings["vehicle"], drive=sim["drive"], actuators=bool(sim["actuators"]))


def build_track(settings: Settings) -> Track:
    """Load the track of `track`, the first of several; files are looked for here and among the packaged tracks."""
    return load_track(_first(settings["track"]), conf_folder() / "track")


def _first(track: Settings) -> dict[str, Any]:
    return {key: value for key, value in track.items() if key != OTHERS}


def build_action(settings: Settings) -> Action:
    """Build the action of `action`; raise ConfigError when it commands another drive than the one of `sim`."""
    action, drive = create_action(settings["action"]), settings["sim"]["drive"]
    if action.drive_mode != drive:
        raise ConfigError(
            f"action={settings['action']['name']} commands {action.drive_mode}, but sim.drive is {drive}; "
            f"use sim={SIMS[action.drive_mode]}"
        )
    return action


def build_timing(settings: Settings) -> Timing:
    """Build control period, integration step and episode length of `sim`."""
    return construct(Timing, {key: settings["sim"][key] for key in ("dt", "step", "max_steps")}, "sim")


def choose_device(name: str) -> torch.device:
    """Return the device for cpu, cuda or auto; raise ConfigError when it is not there."""
    if name not in ("cpu", "cuda", "auto"):
        raise ConfigError(f"device = {name}: allowed is cpu, cuda or auto")
    if name == "cuda" and not torch.cuda.is_available():
        raise ConfigError("device = cuda: no CUDA device is there; use device=cpu or device=auto")
    return torch.device("cuda" if name != "cpu" and torch.cuda.is_available() else "cpu")


def unlimited(settings: Settings) -> dict[str, Any]:
    """Return the settings of a race whose episodes no length cuts off."""
    return {**settings, "sim": {**settings["sim"], "max_steps": 2**31}}


def build_race(
    settings: Settings,
    *,
    cars: int,
    seeds: Sequence[int],
    device: torch.device | None = None,
    termination: Termination | None = None,
    noise: Mapping[str, float] | None = None,
) -> Race:
    """Build the race that the settings describe, for `cars` cars, with one seed for all or one for each.

    `noise` is that of what drivers see, a standard deviation per state, in place of the randomization's.
    """
    check_settings(settings)
    action = build_action(settings)
    return Race(
        vehicle=build_vehicle(settings),
        track=build_track(settings),
        observation=create_observation(settings["obs"]),
        action=action,
        count=cars,
        seeds=seeds,
        randomization=construct(Randomization, settings["dr"], "dr"),
        timing=build_timing(settings),
        termination=termination or OffTrack(),
        noise=noise or {},
        device=device or torch.device("cpu"),
    )


def build_races(
    settings: Settings,
    *,
    cars: int,
    seed: int,
    device: torch.device,
    times: int = 1,
    termination: Termination | None = None,
) -> Race | Races:
    """Build the race of a training: `cars` cars `times` over, each time spread evenly over the tracks in their order.

    Raises ConfigError for fewer cars than tracks, and where the observation is of one track only.
    """
    worlds = one_world_each(settings)
    if len(worlds) == 1:
        return build_race(settings, cars=times * cars, seeds=[seed], device=device, termination=termination)
    if cars < len(worlds):
        raise ConfigError(f"{cars} cars for {len(worlds)} tracks: allowed is at least one for each")
    counts = [cars // len(worlds) + (i < cars % len(worlds)) for i in range(len(worlds))]
    parts = [*zip(worlds, counts, strict=True)] * times
    seeds = [seed + SEED_STEP * i for i in range(len(parts))]
    return Races(
        [
            build_race(world, cars=count, seeds=[own], device=device, termination=termination)
            for (world, count), own in zip(parts, seeds, strict=True)
        ]
    )


def one_world_each(settings: Settings) -> list[Settings]:
    """Return the settings once for each of their tracks, with an observation in one scale for all."""
    others = settings["track"].get(OTHERS)
    if not others:
        return [settings]
    worlds = [{**settings, "track": track} for track in (_first(settings["track"]), *others)]
    seen = create_observation(settings["obs"]).fitted(*map(build_track, worlds))
    return [{**world, "obs": settings_of(settings["obs"]["name"], seen)} for world in worlds]
