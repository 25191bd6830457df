"""A hundred cars with other tyres, masses and actuators: what is called known is right, intervals hold the truth."""

import tempfile
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest
import yaml

from racerl.config import compose_settings
from racerl.identify.identify import identify
from racerl.record.record import record
from racerl.vehicle.load import load_vehicle
from racerl.vehicle.parameter import values

CARS = 100
MARGINS = 0.005  # of the value, by which a sampled log and a simulated one differ without any noise

COMBINED = ("r_Bx1", "r_Bx2", "r_Cx1", "r_By1", "r_By2", "r_Cy1")


def drawn(number: int) -> tuple[list[str], list[str]]:
    """Return the words of a car, and what scales and a ruler tell of it."""
    published = values(load_vehicle(compose_settings("record", ["vehicle=published"])["vehicle"]))
    dice = np.random.default_rng(number)
    mass, wheelbase = 5.1 * dice.uniform(0.6, 1.4), 0.33 * dice.uniform(0.9, 1.1)
    words = [f"vehicle.mass={mass:.4f}", f"vehicle.wheelbase={wheelbase:.4f}"]
    lever = wheelbase * dice.uniform(0.4, 0.6)
    told = [*words, f"vehicle.l_f={lever * dice.normal(1.0, 0.02):.4f}"]  # axles on a kitchen scale
    words += [f"vehicle.l_f={lever:.4f}", f"vehicle.yaw_inertia={mass * wheelbase**2 * dice.uniform(0.2, 0.3):.4f}"]
    words += [f"vehicle.{name}.time_constant={dice.uniform(0.02, 0.12):.4f}" for name in ("steering", "wheel_speed")]
    for axle in ("front", "rear"):
        numbers = {
            "p_Ky1": dice.uniform(1.5, 6.0),
            "p_Kx1": dice.uniform(2.0, 8.0),
            "p_Dy1": dice.uniform(0.55, 0.95),
            "p_Dx1": dice.uniform(0.6, 1.0),
            "p_Cy1": dice.uniform(0.7, 1.5),
            "p_Cx1": dice.uniform(0.8, 1.6),
            "p_Ey1": dice.uniform(-2.0, 0.5),
            "p_Ex1": dice.uniform(-3.0, 0.5),
            **{name: float(published[f"{axle}.{name}"]) * dice.normal(1.0, 0.3) for name in COMBINED},
        }
        words += [f"vehicle.{axle}.{name}={value:.4f}" for name, value in numbers.items()]
    return words, told


def recovered(number: int) -> list[tuple[str, float, bool, bool]]:
    """Return (name, relative error, inside its interval, called known) of every parameter of a car."""
    words, told = drawn(number)
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)
        hidden = [*words, f"hidden.seed={number}", f"seed={number}", "seconds=180"]
        record(compose_settings("record", ["vehicle=published", *hidden]), out / "drive")
        truth = values(load_vehicle(yaml.safe_load((out / "drive" / "vehicle.yaml").read_text())))
        asked = [f"logs=['{out}/drive/log.parquet']", "vehicle=published", "starts=1", "folds=0", "threads=1", *told]
        facts = identify(compose_settings("identify", asked), out / "found")
    rows = []
    for name, p in facts["parameters"].items():
        true = float(truth[name])
        low, high = p["ci95"]
        slack = MARGINS * abs(true)
        rows.append((name, abs(p["value"] / true - 1.0), low - slack <= true <= high + slack, p["identified"]))
    return rows


@pytest.mark.slow
def test_what_is_called_known_is_right_and_intervals_hold_the_truth():
    with ProcessPoolExecutor(mp_context=get_context("spawn")) as pool:
        rows = [row for rows in pool.map(recovered, range(CARS)) for row in rows]
    known = [row for row in rows if row[3]]
    errors = np.array([row[1] for row in known])
    inside, inside_known = (np.mean([row[2] for row in some]) for some in (rows, known))
    print(f"{len(rows)} parameters of {CARS} cars, {len(known)} called known: median error {np.median(errors):.4f},")
    print(f"95 % of them within {np.quantile(errors, 0.95):.4f}; inside {inside:.3f}, known ones {inside_known:.3f}")
    for name in sorted({row[0] for row in rows}):
        mine = [row for row in rows if row[0] == name]
        print(
            f"{name:26s} known {np.mean([row[3] for row in mine]):5.2f} median error "
            f"{np.median([row[1] for row in mine]):7.4f} inside {np.mean([row[2] for row in mine]):5.2f}"
        )
    assert np.median(errors) <= 0.05
    assert 0.90 <= inside <= 0.99
