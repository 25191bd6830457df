"""What was measured: one row per lap driven and one per training, read from the jobs' run folders.

Turn-in: the distance by which a lap's steering δ(s) leads the track's curvature κ(s), the d that maximises
∮ δ(s) κ(s + d) ds, in m.
"""

import math
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from racerl.control.policy import FACTS, UNREFINED
from racerl.documents import read_json
from racerl.errors import DocumentError, RunError
from racerl.evaluate.outcome import METRICS, TRACK, TRAJECTORIES
from racerl.sweep.definition import ARRIVALS, MODEL
from racerl.sweep.jobs import LEARNED, REFINED, Job
from racerl.train.session import read_progress

# columns of a lap
LAP = ("policy", "car", "start", "number", "time_s", "e_off", "off_track_m", "crashed", "valid", "turn_in_m")
Array = NDArray[np.float64]
SHARE = 0.1  # of a training's end, over which its reward is averaged
STEP, REACH = 0.05, 2.0  # m, of the grid that turn-in is looked for on, and how far
COARSE = 0.1  # m, of the grid that steering is kept on


def measure(job: Job, most: int) -> list[dict[str, Any]]:
    """Return the laps that a finished job's policies drove in every car, at most so many of a start.

    Raises RunError for folders that are damaged.
    """
    laps = []
    try:
        for policy, car in job.races:
            raced = job.race(policy, car)
            leads = turn_ins(pd.read_parquet(raced / TRAJECTORIES), pd.read_csv(raced / TRACK))
            for row in read_json(raced / METRICS)["rows"]:
                if row["number"] > most:  # a recorded driver does not stop
                    continue
                laps.append(
                    {
                        "policy": policy,
                        "car": car,
                        "start": row["seed"],
                        "number": row["number"],
                        "time_s": row["time_s"],
                        "e_off": row["e_off"],
                        "off_track_m": row["max_off_track_m"],
                        "crashed": row["crashed"],
                        "valid": row["valid"],
                        "turn_in_m": leads.get((row["seed"], row["number"])),
                    }
                )
        return laps
    except (DocumentError, KeyError, OSError, ValueError) as error:
        raise RunError(f"{job.path}: is damaged ({' '.join(str(error).split())}); remove it and sweep again") from error


def learning(job: Job) -> pd.DataFrame:
    """Return steps and reward per step over a training, one row per update; none where nothing is trained."""
    if job.train is None:
        return pd.DataFrame(columns=["steps", "reward"], dtype=float)
    table = read_progress(job.trained).reindex(columns=["steps", "train/reward"])
    return table.rename(columns={"train/reward": "reward"}).dropna().reset_index(drop=True)


def final_reward(table: pd.DataFrame) -> float | None:
    """Return the mean reward per step over the last tenth of a training; None where none was logged."""
    if table.empty:
        return None
    last = table[table["steps"] >= (1.0 - SHARE) * table["steps"].iloc[-1]]
    return float(last["reward"].mean())


def arrivals(job: Job, policy: str) -> dict[str, float]:
    """Return after how many seconds of training a policy was first within so many percent of the time-optimal lap.

    Settled laps of examinations without a crash count, in the training's own cars; for a policy as it was learned those
    before the refinement. NaN where none is near enough, and where the time-optimal lap of the model is not known.
    """
    found = {f"to_{percent}": math.nan for percent in ARRIVALS}
    floor = read_json(job.race(policy, MODEL) / METRICS)["optimum_s"] if (policy, MODEL) in job.races else None
    if job.train is None or floor is None:
        return found
    last = math.inf
    if policy == LEARNED and (REFINED, MODEL) in job.races:
        last = read_json(job.trained / UNREFINED / FACTS)["learned"]["steps"]
    columns = ["time/seconds", "evaluation/settled_lap_s", "evaluation/crash_share"]
    course = read_progress(job.trained)
    examined = course[course["steps"] <= last].reindex(columns=columns).dropna()
    for percent in ARRIVALS:
        near = examined[columns[1]] <= (1.0 + percent / 100.0) * floor
        arrived = examined[near & (examined[columns[2]] == 0.0)]
        if len(arrived):
            found[f"to_{percent}"] = float(arrived[columns[0]].iloc[0])
    return found


def turn_ins(drive: pd.DataFrame, track: pd.DataFrame) -> dict[tuple[int, int], float]:
    """Return the turn-in in m of every flying lap, by start and number."""
    length = float(track["s_m"].iloc[-1] + track["s_m"].iloc[1] - track["s_m"].iloc[0])
    grid = np.arange(0.0, length, STEP)
    curvature = np.interp(grid, track["s_m"], track["curvature_1_m"], period=length)
    found = {}
    for (start, number), lap in drive[drive["lap"] > 0].groupby(["seed", "lap"]):
        if np.ptp(lap["s"]) > 0.9 * length and lap["delta"].notna().all():  # not every log has steering
            found[int(start), int(number)] = turn_in(np.interp(grid, lap["s"], lap["delta"], period=length), curvature)
    return found


def usual_steering(job: Job, policy: str, car: str) -> pd.DataFrame:
    """Return the median steering angle over a policy's flying laps in a car, along the track; empty without any."""
    drive = pd.read_parquet(job.race(policy, car) / TRAJECTORIES)
    drive = drive[drive["lap"] > 0]
    place = (drive["s"] / COARSE).round().astype(int)
    median = drive.groupby(place)["delta"].median()
    return pd.DataFrame({"s_m": median.index * COARSE, "delta_rad": median.to_numpy()})


def turn_in(steering: Array, curvature: Array) -> float:
    """Return by how many metres steering leads curvature, both on a closed grid of `STEP`; positive is earlier."""
    spectrum = np.conj(np.fft.rfft(steering - steering.mean())) * np.fft.rfft(curvature - curvature.mean())
    likeness = np.fft.irfft(spectrum, len(steering))  # at d = k STEP: Σ δ(s) κ(s + d)
    far = round(REACH / STEP)
    shifts = np.arange(-far, far + 1)
    near = likeness[shifts]
    best = int(np.clip(near.argmax(), 1, len(near) - 2))
    left, middle, right = near[best - 1 : best + 2]
    bend = left - 2.0 * middle + right
    return float((shifts[best] + (0.5 * (left - right) / bend if bend < 0.0 else 0.0)) * STEP)
