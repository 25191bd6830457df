"""Laps of a recorded drive, by the same clock and the same scores as a race's: a drive log and the track it was on.

Every run of the log is followed along the centreline from its first sample. A crash is what it is in a race (more than
0.2 m off the track, turned around, a stop); the driver goes on from there, and the next lap begins at the next line.
A raceline is a drive, too: the one along it at its own speeds.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import torch
from numpy.typing import NDArray
from torch import Tensor

from racerl.assemble import build_track
from racerl.data.load import load_given
from racerl.data.log import POSE, Log
from racerl.env.termination import STOP_SPEED, Crash
from racerl.errors import ConfigError, LogError
from racerl.evaluate.laps import Lap, LapTimer
from racerl.paper import PAPER, find_lap
from racerl.track.frenet import PLACE, FrenetFrame
from racerl.track.raceline import drive_along, is_raceline, read_raceline
from racerl.track.track import Track

RACELINE_LAPS, RACELINE_RATE = 2.1, 100.0  # of a raceline's drive, so that a flying lap is in it; Hz


def read_recorded(settings: Mapping[str, Any]) -> tuple[Track, list[Log]]:
    """Return the track and the logs of `settings["run"]`, a file or one of the paper's laps.

    Raises ConfigError or LogError for what cannot be scored.
    """
    if settings.get("track") is None:
        raise ConfigError(f"{settings['run']}: is a log; say on which track it was driven, for instance track=l_shape")
    if str(settings["run"]).startswith(PAPER):
        title, lap = find_lap(str(settings["run"]))
        return build_track(settings), [Log.from_table(title, lap)]
    if is_raceline(file := Path(settings["run"])):
        drive = drive_along(read_raceline(file), RACELINE_LAPS, RACELINE_RATE)
        return build_track(settings), [Log.from_table(file.name, drive)]
    logs = load_given({"logs": settings["run"], "data": settings["data"]})
    for log in logs:
        lacking = [channel for channel in (*POSE, "v_x") if channel not in log.channels]
        if lacking:
            raise LogError(f"{log.name}: has no {', '.join(lacking)}; laps need poses and the forward speed")
    return build_track(settings), logs


def follow(track: Track, logs: Sequence[Log]) -> tuple[list[Lap], pd.DataFrame]:
    """Return the flying laps of every run and the drive with its places on the track, as of a race."""
    laps: list[Lap] = []
    drives: list[pd.DataFrame] = []
    for log in logs:
        for _, rows in log.table.groupby("run", sort=False):
            number = len(drives)
            timer, drive = _follow_run(track, rows, log.dt)
            laps += [replace(lap, car=number) for lap in timer.laps[0]]
            drives.append(drive.assign(run=number, seed=number))
    return laps, pd.concat(drives, ignore_index=True)


class _Drive(NamedTuple):
    """What a termination looks at, sample by sample, each (K,)."""

    margin: Tensor
    heading: Tensor
    still_time: Tensor


def _follow_run(track: Track, rows: pd.DataFrame, dt: float) -> tuple[LapTimer, pd.DataFrame]:
    """Return the clock that a run leaves, and its drive."""
    places, travelled = _places(track, rows)
    slow = (rows["v_x"].abs() < STOP_SPEED).to_numpy()
    _, _, heading, _, margin = places
    down = Crash()(_Drive(margin, heading, _still_time(slow, dt))).numpy()
    crashed = down & ~np.concatenate([[False], down[:-1]])  # as it happens
    timer, laps = LapTimer(track.length, dt, travelled[:1]), [0]
    for i in range(1, len(rows)):
        before, after = travelled[i - 1 : i], travelled[i : i + 1]
        timer.update(before, after, margin[i : i + 1].double().numpy(), crashed[i : i + 1], after)
        laps.append(int(timer.current()[0]))
    drive = rows[[name for name in ("t", *POSE, "v_x", "v_y", "yaw_rate", "delta", "omega") if name in rows]]
    drive = drive.assign(**dict(zip(PLACE, places.numpy(), strict=True)), travelled=travelled, lap=laps)
    if "delta" not in drive:
        drive["delta"] = rows.get("delta_ref", np.nan)  # not measured
    return timer, drive


def _places(track: Track, rows: pd.DataFrame) -> tuple[Tensor, NDArray[np.float64]]:
    """Return the places (5, K) of a run's samples, each followed from the one before, and the way travelled in m."""
    frame = FrenetFrame(track)
    x, y, yaw = (torch.tensor(rows[name].to_numpy(), dtype=torch.float32) for name in POSE)
    place, _ = frame.locate(x[:1], y[:1], yaw[:1], frame.nearest(x[:1], y[:1]))
    places, travelled = [place], [float(place[0])]
    for i in range(1, len(rows)):
        place, way = frame.locate(x[i : i + 1], y[i : i + 1], yaw[i : i + 1], place[0])
        places.append(place)
        travelled.append(travelled[-1] + float(way))
    return torch.cat(places, dim=1), np.array(travelled)


def _still_time(slow: NDArray[np.bool_], dt: float) -> Tensor:
    """Return for how long the car has been standing at each sample, in s."""
    number = np.arange(len(slow))
    moved = np.maximum.accumulate(np.where(slow, 0, number))  # the last sample at which it moved, or the first
    return torch.tensor((number - moved) * dt)
