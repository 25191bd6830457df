"""The tyres at which fits of the real logs end: one peak or a plateau, and coefficients that a tyre may have."""

import fnmatch
from pathlib import Path

import numpy as np
import pytest
import torch

from racerl.config import compose_settings
from racerl.data.load import load_measured
from racerl.gap.checkpoint import Checkpoint
from racerl.gap.diagnose import cut, refit
from racerl.identify.identify import MODEL, identify
from racerl.vehicle.load import load_vehicle
from racerl.vehicle.ops import TORCH
from racerl.vehicle.parameter import values
from racerl.vehicle.vehicle import Vehicle

REAL = Path(__file__).resolve().parents[3] / "shared" / "data"
LAB = ["vehicle=published"]
JETRACER = ["vehicle=jetracer", "data=dart"]
LOGS = [
    *((f"put/{name}.csv.gz", LAB) for name in ("lab_drive", "tyre_a", "tyre_d")),
    *((f"dart/free_driving_10_{name}.csv.gz", JETRACER) for name in ("01_01", "02_28", "12_05")),
    ("dart/throttle_ramp_rubber.csv.gz", JETRACER),
]
SLIP = np.linspace(0.0, 3.0, 3001)


def forces(vehicle: Vehicle, axle: str) -> dict[str, np.ndarray]:
    """Return force over load at pure slip, (slips,) per direction."""
    tyre, slip = getattr(vehicle, axle), torch.as_tensor(SLIP)
    load = torch.as_tensor(float(tyre.F_z0))
    F_x, _ = tyre.forces(slip, 0.0 * slip, load, vehicle.friction, TORCH)
    _, F_y = tyre.forces(0.0 * slip, slip, load, vehicle.friction, TORCH)
    return {"x": (F_x / load).numpy(), "y": (F_y / load).numpy()}


def oddities(vehicle: Vehicle, settings: dict) -> list[str]:
    """Return what no tyre has: a second peak, a force that turns round, a coefficient out of its range."""
    found = []
    for axle in ("front", "rear"):
        for direction, force in forces(vehicle, axle).items():
            rising = np.sign(np.diff(force)[np.abs(np.diff(force)) > 1e-12])
            if force[1] <= 0 or (force[1:] <= 0).any() or np.count_nonzero(np.diff(rising)) > 1:
                found.append(f"{axle} F_{direction}")
    ranges = {
        name: width["within"]
        for name, width in settings["priors"].items()
        if isinstance(width, dict) and "within" in width
    }
    for name, value in values(vehicle).items():
        for pattern, (low, high) in ranges.items():
            if fnmatch.fnmatch(name, pattern) and not low <= float(value) <= high:
                found.append(f"{name} = {float(value):.3g}")
    return found


def test_an_odd_tyre_is_seen():
    settings = compose_settings("gap", ["logs=a", "vehicle=published"])
    car = load_vehicle(settings["vehicle"])
    assert oddities(car, settings) == []
    for words, said in (
        (["front.p_Cy1=2.6", "front.p_Ky1=20"], "front F_y"),
        (["rear.p_Ex1=-15"], "rear.p_Ex1"),
        (["rear.p_Ky1=60"], "rear.p_Ky1"),
    ):
        words = [f"vehicle.{word}" for word in words]
        odd = load_vehicle(compose_settings("gap", ["logs=a", "vehicle=published", *words])["vehicle"])
        assert any(said in line for line in oddities(odd, settings)), words


@pytest.mark.slow
@pytest.mark.parametrize(("log", "words"), LOGS, ids=[log for log, _ in LOGS])
def test_identify_ends_at_tyres(log, words, tmp_path):
    settings = compose_settings("identify", [f"logs=['{real(log)}']", "folds=0", *words])
    identify(settings, tmp_path / "out")
    assert oddities(load_vehicle({"file": str(tmp_path / "out" / MODEL)}), settings) == []


@pytest.mark.slow
@pytest.mark.parametrize(("log", "words"), LOGS, ids=[log for log, _ in LOGS])
def test_the_refit_of_gap_ends_at_tyres(log, words):
    settings = compose_settings("gap", [f"logs=['{real(log)}']", *words])
    logs = load_measured(settings)
    found = refit(cut(logs, settings), logs, load_vehicle(settings["vehicle"]), settings, Checkpoint())
    assert oddities(found.base.vehicle, settings) == []


def real(log: str) -> Path:
    if not (REAL / log).is_file():
        pytest.skip(f"the measured log {log} is not beside the repository")
    return REAL / log
