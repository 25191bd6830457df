"""Cars that a fit leaves possible: written, read, and refused where they are another vehicle's or damaged."""

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from racerl.config import compose_settings
from racerl.documents import write_parquet
from racerl.errors import RacerlError
from racerl.vehicle.cars import CARS, read_cars, write_cars
from racerl.vehicle.load import load_vehicle

NAMES = ("yaw_inertia", "front.p_Ey1")


def twice():
    """Return a table with two columns of one name."""
    return pa.Table.from_arrays([pa.array([4.0, 5.0]), pa.array([4.5, 5.5])], names=["mass", "mass"])


@pytest.fixture
def vehicle():
    return load_vehicle(compose_settings("train", ["vehicle=published"])["vehicle"])


def test_what_is_read_is_what_was_written_inside_the_bounds(vehicle, tmp_path):
    centre = np.array([vehicle.yaw_inertia, vehicle.front.p_Ey1])
    cars = centre + np.random.default_rng(0).normal(size=(50, 2)) * [0.01, 1.0]
    write_cars(tmp_path, vehicle, NAMES, cars)
    found = read_cars(tmp_path, vehicle)
    assert list(found) == list(NAMES) and np.array_equal(found["yaw_inertia"], cars[:, 0])
    assert found["front.p_Ey1"].max() == 1.0 < cars[:, 1].max()


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda folder, vehicle: None, "cannot be read"),
        (lambda folder, vehicle: write_parquet(folder / CARS, pd.DataFrame({"mass": ["4", "5"]})), "of numbers"),
        (lambda folder, vehicle: pq.write_table(twice(), folder / CARS), "with names of their own"),
        (lambda folder, vehicle: (folder / CARS).write_bytes(b"PAR1"), "is damaged"),
        (lambda folder, vehicle: write_cars(folder, vehicle, (), np.zeros((5, 0))), "0 parameters"),
        (lambda folder, vehicle: write_cars(folder, vehicle, NAMES, np.full((1, 2), 0.1)), "1 cars"),
        (lambda folder, vehicle: write_cars(folder, vehicle, NAMES, np.full((5, 2), np.nan)), "not finite"),
        (
            lambda folder, vehicle: write_cars(folder, vehicle, NAMES, np.full((5, 2), 0.3)),
            "outside what it found, 0.3",
        ),
    ],
)
def test_what_are_no_cars_of_the_vehicle_is_told(vehicle, tmp_path, make, said):
    make(tmp_path, vehicle)
    with pytest.raises(RacerlError, match=said) as error:
        read_cars(tmp_path, vehicle)
    assert "\n" not in str(error.value)


def test_cars_with_an_effect_that_the_vehicle_lacks_are_told(vehicle, tmp_path):
    damped = load_vehicle(compose_settings("train", ["vehicle=published", "+vehicle/effect=yaw_damping"])["vehicle"])
    write_cars(tmp_path, damped, ("effects.yaw_damping.coefficient",), np.array([[0.1], [0.2]]))
    with pytest.raises(RacerlError, match=r"has no 'effects.yaw_damping.coefficient'.*vehicle=.*model\.yaml"):
        read_cars(tmp_path, vehicle)


def test_values_outside_the_bounds_are_told(vehicle, tmp_path):
    write_parquet(tmp_path / CARS, pd.DataFrame({"mass": [-1.0, 6.0]}))
    with pytest.raises(RacerlError, match="mass = -1: allowed is"):
        read_cars(tmp_path, vehicle)
