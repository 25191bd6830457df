"""Layouts: how the columns or topics of somebody's log become the channels of a drive log.

A layout is what a file in `conf/data/` says. For every channel it names a source, a table's column or a bag's topic and
field, and how its numbers become the channel's unit:

    value = scale · raw + offset,   or the straight lines through `points` [[raw, value], …], held outside them.

A name alone is a topic when it begins with a slash, else a column; a list says where to look first. Where no field is
named, the type of the topic's messages says where the channel stands (`racerl.data.messages`). All else has a default.

frame     the tracked point seen from the centre of gravity: forward, left in m; yaw in rad is added to the heading
shift     seconds added to the time stamps of a channel before it is sampled beside the others
resample  rate in Hz of the log; null keeps a table's own samples, and is 100 Hz for a bag, whose topics have own clocks
gap       longest pause in s between samples of one run
velocities  columns: as the file has them; poses: differentiated from its poses; auto: from the poses where the columns
          contradict them, late or of another point
savgol    window (samples, odd) and order of the filter that differentiates poses where velocities are absent
require   column: value, rows with another value are left out
vehicle   wheelbase in m, for the kinematic checks of `racerl data`
"""

import itertools
import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from racerl import bounds
from racerl.data.log import CHANNELS
from racerl.documents import conf_folder, read_yaml
from racerl.errors import ConfigError, RacerlError, suggest
from racerl.registry import construct

COMMANDS = ("delta_ref", "omega_ref")
STAMPS = ("header", "received")
VELOCITIES = ("auto", "columns", "poses")


@dataclass(frozen=True)
class Source:
    """Where a channel comes from and how its numbers are converted."""

    column: str = ""
    topic: str = ""
    field: str = ""  # of a topic's messages; empty: the channel's usual one
    scale: float = 1.0
    offset: float = 0.0
    points: tuple[tuple[float, float], ...] = ()
    hold: bool = False  # the last value counts until the next one; else straight lines between samples

    def convert(self, raw: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the values in the channel's unit."""
        if self.points:
            known, values = np.array(self.points).T
            return np.where(np.isfinite(raw), np.interp(raw, known, values), np.nan)
        return self.scale * raw + self.offset


@dataclass(frozen=True)
class Time:
    """The clock: a table's column and its unit in s, or which stamp of a bag's messages counts."""

    column: str = "t"
    scale: float = 1.0
    stamp: str = "header"


@dataclass(frozen=True)
class Frame:
    """The tracked point seen from the centre of gravity, in m, and the rad that are added to the measured heading."""

    forward: float = 0.0
    left: float = 0.0
    yaw: float = 0.0


@dataclass(frozen=True)
class Savgol:
    """Savitzky–Golay filter: window in samples, order of the polynomial."""

    window: int = 11
    order: int = 3


@dataclass(frozen=True)
class Car:
    """What the checks need to know of the car."""

    wheelbase: float = 0.33  # m


@dataclass(frozen=True)
class Layout:
    """One mapping of `conf/data/`, checked; each channel has its sources in order of preference."""

    channels: Mapping[str, tuple[Source, ...]] = field(default_factory=dict)
    time: Time = Time()
    run: str | None = None
    frame: Frame = Frame()
    shift: Mapping[str, float] = field(default_factory=dict)
    resample: float | None = None
    gap: float = 0.1
    velocities: str = "auto"
    savgol: Savgol = Savgol()
    require: Mapping[str, float] = field(default_factory=dict)
    vehicle: Car = Car()

    @property
    def of_bag(self) -> bool:
        """Whether the channels come from topics."""
        return any(source.topic for sources in self.channels.values() for source in sources)


def read_layout(settings: Mapping[str, Any]) -> Layout:
    """Check a composed `data` group and return it as a layout; raise ConfigError, one line, otherwise."""
    settings = {key: value for key, value in settings.items() if value is not None}
    parts: dict[str, Callable[[Any], Any]] = {
        "channels": _channels,
        "time": lambda s: _time(construct(Time, _mapping("data.time", s), "data.time")),
        "frame": lambda s: _frame(construct(Frame, _mapping("data.frame", s), "data.frame")),
        "savgol": lambda s: _savgol(construct(Savgol, _mapping("data.savgol", s), "data.savgol")),
        "vehicle": lambda s: _car(construct(Car, _mapping("data.vehicle", s), "data.vehicle")),
        "shift": _shift,
        "require": _require,
        "resample": lambda value: bounds.number("data.resample", value, 2.0, 10_000.0, "Hz, or null"),
        "gap": lambda value: bounds.number("data.gap", value, 1e-3, 10.0, "s"),
        "run": lambda value: _text("data.run", value),
        "velocities": _velocities,
    }
    for key in settings:
        if key not in parts:
            raise ConfigError(f"data has no key '{key}'{suggest(key, parts)}")
    return Layout(**{key: parts[key](value) for key, value in settings.items()})


def shipped() -> Iterator[tuple[str, Layout]]:
    """Yield the mappings in conf/data by name; what is wrong with any other is told where it is chosen."""
    for path in sorted((conf_folder() / "data").glob("*.yaml")):
        with suppress(RacerlError):
            yield path.stem, read_layout(read_yaml(path))


def _channels(settings: Any) -> dict[str, tuple[Source, ...]]:
    channels = {}
    for name, entry in _mapping("data.channels", settings).items():
        if name not in CHANNELS:
            raise ConfigError(f"data.channels has no channel '{name}'{suggest(name, CHANNELS)}")
        entries = entry if isinstance(entry, list | tuple) else [entry]
        if entry is not None:
            channels[name] = tuple(_source(name, f"data.channels.{name}", one) for one in entries)
    kinds = {bool(source.topic) for sources in channels.values() for source in sources}
    if len(kinds) > 1:
        raise ConfigError("data.channels: some have a topic, some a column; a log is a bag or a table, not both")
    return channels


def _source(channel: str, where: str, entry: Any) -> Source:
    named = {"topic" if entry.startswith("/") else "column": entry} if isinstance(entry, str) else entry
    settings = dict(_mapping(where, named))
    settings.setdefault("hold", channel in COMMANDS)
    settings["points"] = _points(f"{where}.points", settings.get("points") or ())
    source = construct(Source, settings, where)
    for name in ("column", "topic", "field"):
        if not isinstance(getattr(source, name), str):
            raise ConfigError(f"{where}.{name} = {getattr(source, name)}: a name is expected; put it in quotes")
    if bool(source.column) == bool(source.topic):
        raise ConfigError(f"{where}: give a column (of a table) or a topic (of a bag), one of them")
    if not isinstance(source.hold, bool):
        raise ConfigError(f"{where}.hold = {source.hold}: allowed is true or false")
    if bounds.number(f"{where}.scale", source.scale, -1e9, 1e9, CHANNELS[channel].unit) == 0.0:
        raise ConfigError(f"{where}.scale = 0: would wipe the channel out; give another factor")
    bounds.number(f"{where}.offset", source.offset, -1e9, 1e9, CHANNELS[channel].unit)
    if source.points and (source.scale != 1.0 or source.offset != 0.0):
        raise ConfigError(f"{where}: has points, beside which scale and offset would say nothing; give one of both")
    return source


def _points(where: str, entry: Any) -> tuple[tuple[float, float], ...]:
    pairs = [tuple(pair) if isinstance(pair, list | tuple) else (pair,) for pair in _sequence(where, entry)]
    if any(len(pair) != 2 for pair in pairs):
        raise ConfigError(f"{where}: holds something else than pairs; write [[raw, value], [raw, value]]")
    points = tuple((bounds.number(where, a, -1e9, 1e9, ""), bounds.number(where, b, -1e9, 1e9, "")) for a, b in pairs)
    if points and (len(points) < 2 or any(b[0] <= a[0] for a, b in itertools.pairwise(points))):
        raise ConfigError(f"{where}: {len(points)} points; at least two with increasing raw values are needed")
    return points


def _time(time: Time) -> Time:
    _text("data.time.column", time.column)
    bounds.number("data.time.scale", time.scale, 1e-12, 1e6, "s")
    if time.stamp not in STAMPS:
        raise ConfigError(f"data.time.stamp = {time.stamp}{suggest(time.stamp, STAMPS)}")
    return time


def _frame(frame: Frame) -> Frame:
    bounds.number("data.frame.forward", frame.forward, -10.0, 10.0, "m")
    bounds.number("data.frame.left", frame.left, -10.0, 10.0, "m")
    bounds.number("data.frame.yaw", frame.yaw, -math.pi, math.pi, "rad")
    return frame


def _velocities(value: Any) -> str:
    if value not in VELOCITIES:
        raise ConfigError(f"data.velocities = {value}: allowed is {', '.join(VELOCITIES)}")
    return str(value)


def _savgol(savgol: Savgol) -> Savgol:
    window, order = savgol.window, savgol.order
    bounds.whole("data.savgol.order", order, 1, 7)
    if isinstance(window, bool) or not isinstance(window, int) or window % 2 == 0 or not order < window <= 1001:
        raise ConfigError(f"data.savgol.window = {window}: allowed is an odd number of samples above the order {order}")
    return savgol


def _car(car: Car) -> Car:
    bounds.number("data.vehicle.wheelbase", car.wheelbase, 0.05, 10.0, "m")
    return car


def _shift(settings: Any) -> dict[str, float]:
    shifts = _mapping("data.shift", settings)
    for name in shifts:
        if name not in CHANNELS:
            raise ConfigError(f"data.shift has no channel '{name}'{suggest(name, CHANNELS)}")
    return {name: bounds.number(f"data.shift.{name}", value, -10.0, 10.0, "s") for name, value in shifts.items()}


def _require(settings: Any) -> dict[str, float]:
    columns = _mapping("data.require", settings)
    return {str(name): bounds.number(f"data.require.{name}", value, -1e12, 1e12, "") for name, value in columns.items()}


def _mapping(where: str, value: Any) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise ConfigError(f"{where} = {value}: a mapping is expected; see conf/data/drive_log.yaml")
    return value


def _sequence(where: str, value: Any) -> list[Any] | tuple[Any, ...]:
    if not isinstance(value, list | tuple):
        raise ConfigError(f"{where} = {value}: a list is expected")
    return value


def _text(where: str, value: Any) -> str:
    if not isinstance(value, str) or not value:
        raise ConfigError(f"{where} = {value}: a column's name is expected; put it in quotes")
    return value
