"""The drive stage: a person, or a script in their place, drives the simulated car live.

Practice first, as long as one likes, then a counted session. Writes the whole drive as `log.parquet`
(`racerl.data.log` says what its columns are; `manoeuvre` says practice or counted) and as the ROS 2 bag `log.mcap`
(`racerl.record.bag`), and of the counted laps what an evaluation leaves (`racerl.evaluate.outcome`). All hold what was
true, without the sensors' noise; the window shows what the car's sensors see. Ended early, the laps driven so far are
kept; without one, the log alone.
"""

import importlib.util
import os
import signal
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from racerl import bounds
from racerl.assemble import Car, use_threads
from racerl.documents import write_bytes, write_parquet
from racerl.drive.pedals import create_pedal
from racerl.drive.session import Phase, Session
from racerl.drive.world import build
from racerl.errors import ConfigError, RunError
from racerl.evaluate.drive import Recorder
from racerl.evaluate.outcome import write_outcome
from racerl.optimum.floor import problem_hash
from racerl.optimum.kept import known
from racerl.record.bag import encode_bag
from racerl.registry import construct
from racerl.run import RunFolder

if TYPE_CHECKING:
    from racerl.drive.seat import Seat

LOG, BAG = "log.parquet", "log.mcap"


def drive(settings: Mapping[str, Any], out: Path) -> dict[str, Any] | None:
    """Drive as the settings say; return the metrics written into `out`, None when no counted lap was driven."""
    laps, seed = bounds.whole("laps", settings["laps"], 1, 10_000), bounds.whole("seed", settings["seed"], 0, 2**31 - 1)
    limit = bounds.number("current_limit", settings["current_limit"], 1.0, 500.0, "A")
    require_pygame()
    from racerl.drive.controls import choose_hands
    from racerl.drive.screen import Screen
    from racerl.drive.seat import Seat

    use_threads(1)
    car = construct(Car, settings["car"], "car")
    race = build(settings, car, seed)
    if (out / LOG).exists():
        raise RunError(f"out = {out}: already holds a drive; choose another out=")
    session = Session(race.track.length, race.timing.dt, laps, float(race.travelled))
    with Screen(race.track, race.vehicle) as screen:
        hands = choose_hands(settings["input"], race, session)
        folder = RunFolder.start(out, "drive", settings, seed=[seed])
        seat = Seat(race, session, hands, create_pedal(race, limit), screen, Recorder(race, [seed]))
        with interrupted(seat.leave):
            seat.drive()
    return write(folder, seat, car, seed)


@contextmanager
def interrupted(leave: Callable[[], None]) -> Iterator[None]:
    """Let Ctrl-C, `kill` and a closed terminal ask to leave, instead of breaking a control step off."""
    asking = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    heard = [number for number in asking if signal.getsignal(number) is not signal.SIG_IGN]
    previous = {number: signal.signal(number, lambda number, frame: leave()) for number in heard}
    try:
        yield
    finally:
        for number, before in previous.items():
            signal.signal(number, before)


def require_pygame() -> None:
    """Raise ConfigError where pygame is not installed; keep it from greeting on the terminal."""
    if importlib.util.find_spec("pygame") is None:
        raise ConfigError("racerl drive needs pygame: in your clone, pip install -e '.[drive]'")
    os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")


def write(folder: RunFolder, seat: "Seat", car: Car, seed: int) -> dict[str, Any] | None:
    """Write the log, and the counted laps if there are any; return their metrics."""
    race, laps = seat.race, seat.session.counted
    if not seat.recorder.steps:
        return None
    log = seat.recorder.log()
    write_parquet(folder.path / LOG, log.assign(manoeuvre=pd.Categorical(log["manoeuvre"])))
    write_bytes(folder.path / BAG, encode_bag(log, float(race.vehicle.wheelbase)))
    if not laps:
        return None
    problem = problem_hash(race.vehicle, race.track, race.action)
    metrics = write_outcome(
        folder,
        laps,
        [seed],
        log[log["manoeuvre"] == Phase.COUNTED.value].drop(columns="manoeuvre"),
        race.track,
        label="human" if seat.hands.live else "script",
        car=car.name,
        controller=seat.name,
        floor=known(race.vehicle, race.track, race.action),
        race=race,
        drive_mode=race.action.drive_mode,
        laps_wanted=seat.session.laps,
    )
    folder.finish(log=LOG, nan_cars=race.faults, problem=problem)
    return metrics
