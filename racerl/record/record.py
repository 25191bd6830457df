"""The record stage: drives a simulated car, measures it with its sensors' noise and writes a drive log.

Writes the log (`racerl.data.log` says what its columns are; `manoeuvre` is added) and `vehicle.yaml`, the car that was
driven in the form of `conf/vehicle/*.yaml`, to compare with.
"""

import gzip
import io
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from racerl.assemble import build_track
from racerl.data.differentiate import velocities
from racerl.documents import write_bytes, write_yaml
from racerl.errors import ConfigError
from racerl.record.drivers import Scene, create_driver
from racerl.record.hidden import Hidden
from racerl.record.sensors import Sensors
from racerl.record.simulate import Recording, simulate
from racerl.registry import construct
from racerl.run import RunFolder
from racerl.vehicle.load import load_vehicle, vehicle_document
from racerl.vehicle.vehicle import STATE, Vehicle

VEHICLE = "vehicle.yaml"
FORMATS = (".parquet", ".csv", ".csv.gz")
MOVING = 1.0  # m/s above which slips are told


def record(
    settings: Mapping[str, Any], out: Path, on_progress: Callable[[float], None] = lambda share: None
) -> dict[str, Any]:
    """Write the log that the settings describe into `out`; return what it holds, in numbers."""
    _check(settings)
    sim, car, smoothing = settings["sim"], settings["car"], settings["smoothing"]
    sensors = construct(Sensors, car.get("sensors") or {}, "car.sensors")
    hidden = construct(Hidden, settings["hidden"], "hidden")
    actuators = bool(sim["actuators"]) and bool(car["actuators"])
    configured = load_vehicle(settings["vehicle"], sim["drive"], actuators)
    document = vehicle_document(settings["vehicle"], hidden.draw(configured), sim["drive"])
    driven = load_vehicle(document, sim["drive"], actuators)
    noise, choices = (np.random.default_rng(child) for child in np.random.SeedSequence(settings["seed"]).spawn(2))
    floor_x, floor_y = (float(side) for side in settings["floor"])
    scene = Scene(
        vehicle=configured,
        track=build_track(settings),
        floor=(floor_x, floor_y),
        dt=1.0 / settings["rate"],
        seconds=float(settings["seconds"]),
        generator=choices,
    )
    current_limit = float(driven.drive.current_limit) if sim["drive"] == "motor_current" else None  # type: ignore[attr-defined]

    pose, driving = create_driver(settings["drive"]).begin(scene)
    folder = RunFolder.start(out, "record", settings, seed=settings["seed"])
    recording = simulate(
        driven,
        pose,
        driving,
        scene,
        sensors,
        step=settings["step"],
        generator=noise,
        current_limit=current_limit,
        on_progress=on_progress,
    )
    log = table(recording, smoothing["window"], smoothing["order"], current_limit is not None)
    write_yaml(folder.path / VEHICLE, document)
    write_bytes(folder.path / settings["file"], encode(log, settings["file"]))
    facts = {"rows": len(log), "runs": int(log["run"].nunique()), **excitation(driven, recording)}
    folder.finish(log=settings["file"], **facts)
    return facts


def table(recording: Recording, window: int, order: int, motor_current: bool) -> pd.DataFrame:
    """Return the log: velocities differentiated from the noisy poses, run by run."""
    x, y, yaw, delta, omega = recording.measured.T
    velocity = np.zeros((3, len(x)))
    for run in np.unique(recording.run):
        rows = recording.run == run
        if rows.sum() >= window:
            velocity[:, rows] = velocities(x[rows], y[rows], yaw[rows], recording.dt, window, order)
        else:
            velocity[:, rows] = np.nan
    delta_ref, drive_ref = recording.command.T
    columns = {
        "t": np.round(np.arange(len(x)) * recording.dt, 9),
        "run": recording.run,
        "x": x,
        "y": y,
        "yaw": yaw,
        **dict(zip(("v_x", "v_y", "yaw_rate"), velocity, strict=True)),
        "delta": delta,
        "omega": omega,
        "delta_ref": delta_ref,
        "current" if motor_current else "omega_ref": drive_ref,
        "manoeuvre": pd.Categorical(recording.doing),
    }
    return pd.DataFrame(columns)


def encode(log: pd.DataFrame, name: str) -> bytes:
    """Return the log as Parquet, or as CSV with six decimals; the same log gives the same bytes."""
    if name.endswith(".parquet"):
        stream = io.BytesIO()
        log.to_parquet(stream, index=False)
        return stream.getvalue()
    text = log.to_csv(index=False, float_format="%.6f").encode()
    return gzip.compress(text, compresslevel=6, mtime=0) if name.endswith(".gz") else text


def slips(vehicle: Vehicle, truth: np.ndarray) -> pd.DataFrame:
    """Return slip ratios and angles (rad) of both axles for states (K, 8), and the speed in m/s."""
    state = pd.DataFrame(truth, columns=list(STATE))
    sin, cos = np.sin(state["delta"]), np.cos(state["delta"])
    lateral_f = state["v_y"] + vehicle.l_f * state["yaw_rate"]
    V_xf, V_yf = state["v_x"] * cos + lateral_f * sin, lateral_f * cos - state["v_x"] * sin
    V_yr = state["v_y"] - vehicle.l_r * state["yaw_rate"]
    return pd.DataFrame(
        {
            "speed": np.hypot(state["v_x"], state["v_y"]),
            "alpha_f": -np.arctan2(V_yf, V_xf.abs()),
            "alpha_r": -np.arctan2(V_yr, state["v_x"].abs()),
            "kappa": (state["omega"] - state["v_x"]) / state["v_x"].abs().clip(lower=0.1),
        }
    )


def excitation(vehicle: Vehicle, recording: Recording) -> dict[str, float]:
    """Return how far the drive went: top speed, and the slips that 1 % of the moving time exceeds to either side."""
    reached = slips(vehicle, recording.truth)
    moving = reached[reached["speed"] > MOVING]
    if moving.empty:
        moving = reached
    facts = {"speed_max": float(reached["speed"].max())}
    for name in ("alpha_f", "alpha_r", "kappa"):
        facts[f"{name}_low"], facts[f"{name}_high"] = (float(moving[name].quantile(q)) for q in (0.01, 0.99))
    return facts


def _check(settings: Mapping[str, Any]) -> None:
    """Raise ConfigError for numbers that make no drive."""
    ranges = {"seconds": (1.0, 36000.0), "rate": (20.0, 1000.0), "step": (1e-5, 0.05), "seed": (0, 2**63 - 1)}
    for key, (low, high) in ranges.items():
        value = settings[key]
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not low <= value <= high:
            raise ConfigError(f"{key} = {value}: allowed is {low:g} … {high:g}")
    if not isinstance(settings["seed"], int):
        raise ConfigError(f"seed = {settings['seed']}: a whole number is expected")
    floor = settings["floor"]
    if not isinstance(floor, list) or len(floor) != 2 or not all(isinstance(side, (int, float)) for side in floor):
        raise ConfigError(f"floor = {floor}: two lengths in m are expected, for instance floor=[12,8]")
    name = settings["file"]
    if not isinstance(name, str) or not name.endswith(FORMATS) or Path(name).name != name:
        raise ConfigError(f"file = {name}: a name that ends with {' or '.join(FORMATS)} is expected")
    window, order = (settings["smoothing"][key] for key in ("window", "order"))
    if not all(isinstance(value, int) for value in (window, order)) or not 1 <= order < window or window % 2 == 0:
        raise ConfigError(f"smoothing: window = {window}, order = {order}: an odd window above the order is expected")
