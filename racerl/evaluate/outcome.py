"""What an evaluation leaves behind, whoever drove.

`metrics.json` (scores and one row per lap), `trajectories.parquet` (the drive-log format with the place on the track
added) and `track.csv` (centreline and boundaries, for drawing).
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from racerl.documents import write_json, write_parquet, write_text
from racerl.env.black_box import write_failures
from racerl.env.race import Race
from racerl.evaluate.laps import Lap, rows, score
from racerl.optimum.floor import gap
from racerl.run import RunFolder
from racerl.track.track import Track

METRICS, TRAJECTORIES, TRACK = "metrics.json", "trajectories.parquet", "track.csv"


def write_outcome(
    folder: RunFolder,
    laps: Sequence[Lap],
    seeds: Sequence[int],
    drive: pd.DataFrame,
    track: Track,
    *,
    label: str,
    car: str,
    controller: str,
    floor: float | None = None,
    race: Race | None = None,
    **facts: Any,
) -> dict[str, Any]:
    """Write the laps of cars with these seeds, their drive and its track; return what is in metrics.json.

    `label` is the driver's name in tables, `floor` the time-optimal lap in s, `race` what a simulated drive was in.
    """
    scored = score(laps)
    metrics = {
        **scored,
        "optimum_s": floor,
        "mean_over_optimum": gap(scored["mean_lap_s"], floor),
        "track": track.name,
        "label": label,
        "car": car,
        "controller": controller,
        "seed": list(seeds),
        **facts,
        "nan_cars": race.faults if race else 0,
        "git_sha": folder.manifest["git_sha"],
        "rows": rows(laps, seeds),
    }
    write_parquet(folder.path / TRAJECTORIES, drive)
    if race:
        write_failures(folder.path, [race])
    write_text(folder.path / TRACK, track_table(track).to_csv(index=False, float_format="%.5f"))
    write_json(folder.path / METRICS, metrics)
    return metrics


def track_table(track: Track) -> pd.DataFrame:
    """Return centreline and boundaries in m, as a run's file has them."""
    s = np.arange(len(track.x)) * track.spacing
    (left_x, left_y), (right_x, right_y) = track.boundary(1), track.boundary(-1)
    columns = {
        "s_m": s,
        "x_m": track.x,
        "y_m": track.y,
        "left_x_m": left_x,
        "left_y_m": left_y,
        "right_x_m": right_x,
        "right_y_m": right_y,
        "curvature_1_m": track.curvature,
    }
    return pd.DataFrame(columns).round(5)
