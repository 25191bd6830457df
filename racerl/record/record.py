"""The record stage: drives a simulated car, measures it with its sensors' noise and writes a drive log.

Writes the log (`racerl.data.log` says what its columns are; `manoeuvre` is added) and `vehicle.yaml`, the car that was
driven in the form of `conf/vehicle/*.yaml`, to compare with.
"""

import gzip
import io
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from racerl import bounds
from racerl.assemble import Car, build_track
from racerl.data.differentiate import velocities
from racerl.data.log import LABEL
from racerl.documents import write_bytes, write_yaml
from racerl.errors import ConfigError
from racerl.record.bag import encode_bag
from racerl.record.drivers import Drive, Measured, Pose, Scene, create_driver
from racerl.record.hidden import Hidden
from racerl.record.sensors import Sensors
from racerl.record.shown import as_shown
from racerl.record.simulate import Recording, simulate
from racerl.registry import construct
from racerl.run import RunFolder
from racerl.vehicle.load import load_vehicle, vehicle_document
from racerl.vehicle.vehicle import STATE, Vehicle

VEHICLE = "vehicle.yaml"
FORMATS = (".parquet", ".csv", ".csv.gz", ".mcap")
MOVING = 1.0  # m/s above which slips are told


@dataclass(frozen=True)
class Plan:
    """A drive that is ready to begin."""

    document: dict[str, Any]  # the driven car, in the form of conf/vehicle/*.yaml
    vehicle: Vehicle  # the driven car
    pose: Pose
    driving: Callable[[Measured], Drive]
    scene: Scene
    sensors: Sensors
    noise: np.random.Generator
    step: float  # s

    @classmethod
    def of(cls, settings: Mapping[str, Any]) -> "Plan":
        """Build everything that the settings describe; raise a RacerlError for what cannot be driven."""
        _check(settings)
        sim, car = settings["sim"], construct(Car, settings["car"], "car")
        actuators = car.has_actuators(sim)
        configured = load_vehicle(settings["vehicle"], sim["drive"], actuators)
        hidden = construct(Hidden, settings["hidden"], "hidden")
        worn = car.wear(settings["vehicle"])
        document = vehicle_document(worn, hidden.draw(load_vehicle(worn, sim["drive"], actuators)), sim["drive"])
        noise, choices = (np.random.default_rng(child) for child in np.random.SeedSequence(settings["seed"]).spawn(2))
        scene = Scene(
            vehicle=configured,
            track=build_track(settings),
            floor=(float(settings["floor"][0]), float(settings["floor"][1])),
            dt=1.0 / settings["rate"],
            seconds=float(settings["seconds"]),
            generator=choices,
        )
        pose, driving = create_driver(settings["drive"]).begin(scene)
        return cls(
            document=document,
            vehicle=load_vehicle(document, sim["drive"], actuators),
            pose=pose,
            driving=driving,
            scene=scene,
            sensors=construct(Sensors, car.sensors, "car.sensors"),
            noise=noise,
            step=settings["step"],
        )

    def drive(self, on_progress: Callable[[float], None] = lambda share: None) -> Recording:
        """Drive; a plan is good for one drive, since its generators move on."""
        recording = simulate(
            self.vehicle,
            self.pose,
            self.driving,
            self.scene,
            self.sensors,
            step=self.step,
            generator=self.noise,
            on_progress=on_progress,
        )
        return as_shown(self.vehicle, recording)


def record(
    settings: Mapping[str, Any], out: Path, on_progress: Callable[[float], None] = lambda share: None
) -> dict[str, Any]:
    """Write the log that the settings describe into `out`; return what it holds, in numbers."""
    plan = Plan.of(settings)
    folder = RunFolder.start(out, "record", settings, seed=settings["seed"])
    recording = plan.drive(on_progress)
    log = table(recording, **settings["smoothing"])
    write_yaml(folder.path / VEHICLE, plan.document)
    bag = settings["file"].endswith(".mcap")
    content = encode_bag(log, float(plan.vehicle.wheelbase)) if bag else encode(log, settings["file"])
    write_bytes(folder.path / settings["file"], content)
    facts = {"rows": len(log), "runs": int(log["run"].nunique()), **excitation(plan.vehicle, recording)}
    folder.finish(log=settings["file"], **facts)
    return facts


def table(recording: Recording, window: int, order: int) -> pd.DataFrame:
    """Return the log: velocities differentiated from the noisy poses, run by run."""
    x, y, yaw, delta, omega, current = recording.measured.T
    velocity = np.zeros((3, len(x)))
    for run in np.unique(recording.run):
        rows = recording.run == run
        if rows.sum() >= window:
            velocity[:, rows] = velocities(x[rows], y[rows], yaw[rows], recording.dt, window, order)
        else:
            velocity[:, rows] = np.nan
    delta_ref, omega_ref = recording.command.T
    drive = {"current": current} if recording.motor_current else {"omega_ref": omega_ref}
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
        **drive,
        LABEL: pd.Categorical(recording.doing),
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
    lateral_f = state["v_y"] + vehicle.arm * state["yaw_rate"]
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
    ranges = {"seconds": (1.0, 36000.0), "rate": (20.0, 1000.0), "step": (1e-5, 0.05)}
    for key, (low, high) in ranges.items():
        bounds.number(key, settings[key], low, high)
    bounds.whole("seed", settings["seed"], 0, 2**63 - 1)
    floor = settings["floor"]
    if not isinstance(floor, list) or len(floor) != 2 or not all(isinstance(side, (int, float)) for side in floor):
        raise ConfigError(f"floor = {floor}: two lengths in m are expected, for instance floor=[12,8]")
    name = settings["file"]
    if not isinstance(name, str) or not name.endswith(FORMATS) or Path(name).name != name:
        raise ConfigError(f"file = {name}: a name that ends with {' or '.join(FORMATS)} is expected")
    window, order = (settings["smoothing"][key] for key in ("window", "order"))
    if not all(isinstance(value, int) for value in (window, order)) or not 1 <= order < window or window % 2 == 0:
        raise ConfigError(f"smoothing: window = {window}, order = {order}: an odd window above the order is expected")
