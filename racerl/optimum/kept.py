"""Time-optimal laps that are kept: each is found once for its car, track and limits, in the user's cache.

A lap is known by its problem, the car's equations and what looks for it, so that none outlives a change of these. Where
many processes ask for one lap, the first finds it and the others wait. That a problem has no lap is kept as well. A
cache that cannot be used costs time, no result.
"""

import functools
import hashlib
import logging
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

import casadi
import numpy as np

from racerl.documents import alone, read_json, user_cache, write_json
from racerl.env.actions import Action
from racerl.errors import DocumentError, OptimumError
from racerl.optimum.along import motion, scales
from racerl.optimum.collocation import ORDER, Solution
from racerl.optimum.corridor import Stretch
from racerl.optimum.floor import known_floor, problem_hash
from racerl.optimum.optimum import find_optimum
from racerl.track.track import Track
from racerl.vehicle.vehicle import Vehicle

log = logging.getLogger(__name__)


def kept_folder() -> Path:
    """Return where laps are kept."""
    return user_cache("optimum")


def kept_lap(
    vehicle: Vehicle, track: Track, action: Action, on_share: Callable[[float], None] = lambda share: None
) -> Solution:
    """Return the time-optimal lap, found now where it is not kept yet; raise OptimumError where there is none."""
    path = _path(vehicle, track, action)
    lap = _read(path, vehicle, action)
    if lap is not None:
        return lap
    with ExitStack() as stack:
        with suppress(OSError):  # a cache that cannot be written has nothing to guard
            path.parent.mkdir(parents=True, exist_ok=True)
            stack.enter_context(alone(path.with_suffix(".lock")))
        lap = _read(path, vehicle, action)  # another process may have found it meanwhile
        if lap is not None:
            return lap
        try:
            lap = find_optimum(vehicle, track, action, on_share).solution
        except OptimumError as error:
            _write(path, {"error": str(error)})
            raise
        _write(path, {key: _plain(getattr(lap, key)) for key in ("states", "commands", "durations", "stretch")})
        return lap


def known(vehicle: Vehicle, track: Track, action: Action) -> float | None:
    """Return the least lap time in s, of the runs under `outputs` or of a lap kept; None where nobody looked yet."""
    floor = known_floor(problem_hash(vehicle, track, action))
    if floor is not None:
        return floor
    try:
        lap = _read(_path(vehicle, track, action), vehicle, action)
    except OptimumError:
        return None
    return None if lap is None else lap.time


def found(
    vehicle: Vehicle, track: Track, action: Action, on_share: Callable[[float], None] = lambda share: None
) -> float | None:
    """Return the least lap time in s of a lap found now; None, with a warning, where there is none."""
    try:
        return kept_lap(vehicle, track, action, on_share).time
    except OptimumError as error:
        _warn(f"laps are not set against a time-optimal one: {error}")
        return None


@functools.cache
def _warn(text: str) -> None:
    """Say it once: a process may race in the same car many times."""
    log.warning("%s", text)


def _path(vehicle: Vehicle, track: Track, action: Action) -> Path:
    """Return the file of a problem; raise OptimumError for a foreign body, whose equations are not known here."""
    if vehicle.body:
        raise OptimumError(f"of body {vehicle.body} no least lap time is known")
    z, u, kappa = casadi.SX.sym("z", len(scales(vehicle, action))), casadi.SX.sym("u", 2), casadi.SX.sym("k")
    speed, rows = motion(vehicle, action, z, u, kappa)
    equations = casadi.Function("motion", [z, u, kappa], [casadi.vertcat(speed, *rows)]).serialize()
    identity = hashlib.sha256(f"{problem_hash(vehicle, track, action)}\0{equations}\0{_method()}".encode())
    return kept_folder() / f"{identity.hexdigest()[:32]}.json"


@functools.cache
def _method() -> str:
    """Return the source of what looks for laps."""
    return "".join(path.read_text() for path in sorted(Path(__file__).parent.glob("*.py")))


def _plain(part: Any) -> Any:
    return part.tolist() if isinstance(part, np.ndarray) else {key: _plain(row) for key, row in asdict(part).items()}


def _write(path: Path, content: dict[str, Any]) -> None:
    try:
        write_json(path, content)
    except OSError as error:
        log.info("%s: cannot be kept (%s)", path, error.strerror)


def _read(path: Path, vehicle: Vehicle, action: Action) -> Solution | None:
    """Return a lap; None where there is no sound one, OptimumError where it is known that there is none."""
    try:
        content = read_json(path)
        if "error" in content:
            raise OptimumError(str(content["error"]))
        states, commands, durations = (np.array(content[key], float) for key in ("states", "commands", "durations"))
        stretch = Stretch(**{key: np.array(row, float) for key, row in content["stretch"].items()})
    except (DocumentError, KeyError, TypeError, ValueError, AttributeError, OverflowError):
        return None
    count = len(durations)
    shapes = [states.shape, commands.shape, *(row.shape for row in vars(stretch).values())]
    expected = [(len(scales(vehicle, action)), ORDER * count), (2, count), *[(ORDER * count,)] * len(vars(stretch))]
    return Solution(vehicle, action, stretch, states, commands, durations) if shapes == expected and count else None
