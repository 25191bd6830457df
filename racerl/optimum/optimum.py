"""The optimum stage: the fastest lap that the car's equations, its limits and the track allow.

A car that gains from sliding has a local minimum for every way of driving; the first guesses have the nose along the
line or turned into the turns, and the best lap found is refined until its time settles. Writes `optimum.json`,
`raceline.csv` in the TUM format and `trajectory.parquet`.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import torch
from numpy.typing import NDArray

from racerl.assemble import build_action, build_timing, build_track, build_vehicle, use_threads
from racerl.documents import write_json, write_parquet, write_text
from racerl.env.actions import Action
from racerl.errors import OptimumError
from racerl.optimum.collocation import Collocation, Solution
from racerl.optimum.corridor import Corridor
from racerl.optimum.floor import problem_hash
from racerl.optimum.held import Held, hold
from racerl.run import RunFolder
from racerl.track.frenet import FrenetFrame
from racerl.track.raceline import raceline_text
from racerl.track.track import Track
from racerl.vehicle.integrate import advance
from racerl.vehicle.ops import TORCH
from racerl.vehicle.vehicle import Vehicle

RESULT, RACELINE, TRAJECTORY = "optimum.json", "raceline.csv", "trajectory.parquet"
COARSEST = 0.33  # of the narrowest half-width: intervals of the first mesh
LEAST_INTERVALS = 60
SETTLED = 1e-3  # of the lap time, between two meshes
REFINEMENTS = 4  # doublings at most
SLIDING = (0.0, 0.6, 1.2)  # rad, sideslip of the first guesses
DISTINCT = 5e-3  # of the lap time, by which two first guesses have led to two laps

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Optimum:
    """The lap, how it settled, and the lap with held commands."""

    solution: Solution
    corridor: Corridor
    meshes: list[dict[str, float]]  # intervals, time_s
    ways: list[dict[str, float]]  # time_s and sideslip_rad of the different laps on the first mesh, the fastest first

    @property
    def time(self) -> float:
        """The lap time in s."""
        return self.solution.time


def find_optimum(
    vehicle: Vehicle, track: Track, action: Action, on_share: Callable[[float], None] = lambda share: None
) -> Optimum:
    """Return the time-optimal lap; raise OptimumError when none is found or the mesh does not settle.

    Commands that act late cost a periodic lap nothing: they are given earlier.
    """
    if local := [name for name, effect in vehicle.effects.items() if not effect.uniform]:
        raise OptimumError(
            f"{', '.join(local)}: an optimum is sought on a track that is the same everywhere and at all times; "
            f"leave it out with ~vehicle.effects.{local[0]}"
        )
    corridor = Corridor(track)
    intervals = coarse_mesh(corridor, track)
    started = starts(Collocation(vehicle, action, corridor, intervals))
    best = started[0]
    meshes = [{"intervals": intervals, "time_s": best.time}]
    for refinement in range(REFINEMENTS):
        on_share((1 + refinement) / (1 + REFINEMENTS))
        intervals *= 2
        finer = Collocation(vehicle, action, corridor, intervals).solve(best.guess)
        change, best = abs(finer.time / best.time - 1.0), finer
        meshes.append({"intervals": intervals, "time_s": best.time})
        if change < SETTLED:
            return Optimum(best, corridor, meshes, different(started))
    raise OptimumError(f"the lap time has not settled: it still moves by {change:.1%} at {intervals} intervals")


def coarse_mesh(corridor: Corridor, track: Track) -> int:
    """Return how many intervals the first mesh has."""
    return max(LEAST_INTERVALS, round(corridor.length / (COARSEST * track.min_half_width)))


def starts(problem: Collocation) -> list[Solution]:
    """Return the laps that the first guesses lead to, the fastest first; raise OptimumError when none leads to any."""

    def solve(sliding: float) -> Solution | OptimumError:
        try:
            return problem.solve(problem.guess(sliding))
        except OptimumError as error:
            return error

    with ThreadPoolExecutor(torch.get_num_threads()) as pool:  # the solver lets other threads work meanwhile
        outcomes = list(pool.map(solve, SLIDING))
    found = [outcome for outcome in outcomes if isinstance(outcome, Solution)]
    if not found:
        raise next(outcome for outcome in outcomes[::-1] if isinstance(outcome, OptimumError))
    return sorted(found, key=lambda solution: solution.time)


def different(laps: Sequence[Solution]) -> list[dict[str, float]]:
    """Return time and greatest sideslip of laps, the fastest first, but for those that take as long as another."""
    ways: list[dict[str, float]] = []
    for lap in laps:
        if not ways or lap.time > (1 + DISTINCT) * ways[-1]["time_s"]:
            ways.append({"time_s": lap.time, "sideslip_rad": lap.largest_sideslip})
    return ways


def replay(vehicle: Vehicle, held: Held) -> Array:
    """Return the states (S, K + 1) of the race's integrator under a lap's commands, from its first state."""
    state = torch.as_tensor(held.states[:, :1])
    states = [state]
    for command in torch.as_tensor(held.references.T):
        step = held.period / held.substeps
        states.append(advance(vehicle, states[-1], command[:, None], step, held.substeps, TORCH))
    return torch.cat(states, dim=1).numpy()


def margins(track: Track, x: Array, y: Array) -> Array:
    """Return the distance to the nearer boundary, as the race sees it, along a path of points (M,) in m."""
    frame = FrenetFrame(track, dtype=torch.float64)
    s = torch.tensor([float(np.hypot(track.x - x[0], track.y - y[0]).argmin() * track.spacing)], dtype=torch.float64)
    found = []
    for point in torch.as_tensor(np.stack([x, y], axis=1)):
        foot = frame.project(point[:1], point[1:], s)
        s = foot.s
        left, right = frame.lookup(s, frame.width_left, frame.width_right)
        left, right = left - foot.n, right + foot.n
        found.append(float(torch.minimum(left, right)))
    return np.array(found)


def optimum(
    settings: Mapping[str, Any], out: Path, on_progress: Callable[[float, str], None] = lambda share, remark: None
) -> dict[str, Any]:
    """Find the time-optimal lap of a car on a track; return what is written to optimum.json."""
    use_threads(settings["threads"])
    vehicle, track = build_vehicle(settings), build_track(settings)
    action, timing = build_action(settings), build_timing(settings)
    began = time.perf_counter()
    folder = RunFolder.start(out, "optimum", settings, threads=settings["threads"])
    best = find_optimum(vehicle, track, action, lambda share: on_progress(0.7 * share, "continuous commands"))
    on_progress(0.7, f"{best.time:.3f} s; held commands")
    held = hold(best.corridor, best.solution, timing.dt, timing.substeps)
    facts = {
        "track": track.name,
        "time_s": best.time,
        "meshes": best.meshes,
        "ways": best.ways,
        "held": {
            "time_s": held.time,
            "period_s": held.period,
            "asked_period_s": timing.dt,
            **_feasibility(vehicle, track, held),
        },
        "seconds": round(time.perf_counter() - began, 2),
    }
    table = trajectory(best.solution)
    write_parquet(folder.path / TRAJECTORY, table)
    about = f"racerl optimum: {track.name}", f"lap time {best.time:.3f} s"
    write_text(folder.path / RACELINE, raceline_text(raceline(table), table["distance"].iloc[-1], about))
    write_json(folder.path / RESULT, facts)
    problem = problem_hash(vehicle, track, action)
    folder.finish(seconds=facts["seconds"], problem=problem, time_s=best.time)
    return facts


def _feasibility(vehicle: Vehicle, track: Track, held: Held) -> dict[str, float]:
    """Return how the lap fares in the race's integrator, started once and driven open loop."""
    driven = replay(vehicle, held)
    apart = driven[:2] - held.states[:2, :: held.substeps]
    return {
        "replay_apart_m": float(np.hypot(*apart).max()),
        "replay_least_margin_m": float(margins(track, driven[0], driven[1]).min()),
    }


def trajectory(solution: Solution) -> pd.DataFrame:
    """Return the lap as a table: time, path, motion and references."""
    order = len(solution.stretch.s) // len(solution.durations)
    columns = dict(zip(solution.vehicle.states, solution.cartesian, strict=True))
    steering, drive = np.repeat(solution.references, order, axis=1)
    path = np.hypot(np.diff(columns["x"], prepend=columns["x"][-1]), np.diff(columns["y"], prepend=columns["y"][-1]))
    return pd.DataFrame(
        {"t": solution.times, "distance": np.cumsum(path), **columns, "delta_ref": steering, "drive_ref": drive}
    )


def raceline(table: pd.DataFrame) -> pd.DataFrame:
    """Return a lap as a TUM raceline: s, x, y, heading of the path (0 is +y), its curvature, speed and acceleration."""
    x, y, t, s = (table[name].to_numpy() for name in ("x", "y", "t", "distance"))
    speed = np.hypot(table["v_x"], table["v_y"]).to_numpy()
    course = np.unwrap(table["yaw"].to_numpy() + np.arctan2(table["v_y"], table["v_x"]).to_numpy())
    columns = {
        "s_m": s - s[0],
        "x_m": x,
        "y_m": y,
        "psi_rad": np.mod(course - np.pi / 2 + np.pi, 2 * np.pi) - np.pi,
        "kappa_radpm": np.gradient(course, s),
        "vx_mps": speed,
        "ax_mps2": np.gradient(speed, t),
    }
    return pd.DataFrame(columns)
