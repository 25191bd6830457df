"""Cars that a log leaves possible: parameters drawn together from what a fit says of them, correlations included.

`racerl identify` and `racerl gap`, in what it changed, write them beside `model.yaml`; `dr=posterior:RUN` trains in
them.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from racerl.documents import as_frame, read_bytes, write_parquet
from racerl.errors import ConfigError, VehicleError, suggest
from racerl.vehicle.parameter import check_value, specifications, values
from racerl.vehicle.vehicle import Vehicle

Array = NDArray[np.float64]
CARS = "cars.parquet"
MAX_BYTES, MAX_CARS, MAX_NAMES = 64 * 1024 * 1024, 100_000, 500
FEWEST = 2
ROUNDED = 1e-4  # share by which a number of model.yaml may be rounded


def write_cars(folder: Path, vehicle: Vehicle, names: Sequence[str], cars: Array) -> None:
    """Write a vehicle's parameters in cars (K, P), by dotted names and inside their bounds, into a run folder."""
    known = specifications(vehicle)
    low, high = ([getattr(known[name], end) for name in names] for end in ("low", "high"))
    write_parquet(folder / CARS, pd.DataFrame(np.clip(cars, low, high), columns=list(names)))


def read_cars(run: Path, vehicle: Vehicle) -> dict[str, Array]:
    """Return the values (K,) of every parameter that a run's cars differ in.

    Raises VehicleError for a file that is damaged, ConfigError where the vehicle is not one of its cars.
    """
    path = run / CARS
    table = _read(path)
    known, bounds = values(vehicle), specifications(vehicle)
    advice = f"train the vehicle that it found, with its actuators: vehicle={run}/model.yaml"
    for name, drawn in table.items():
        if name not in known:
            raise ConfigError(f"dr = posterior:{run}: the vehicle has no '{name}'{suggest(name, known)}; {advice}")
        low, high = (check_value(f"{path}: {name}", bounds[name], float(end)) for end in (drawn.min(), drawn.max()))
        own = float(known[name])
        if not low - ROUNDED * abs(own) <= own <= high + ROUNDED * abs(own):
            raise ConfigError(
                f"dr = posterior:{run}: {name} = {own:g} lies outside what it found, {low:g} … {high:g}; {advice}"
            )
    return table


def _read(path: Path) -> dict[str, Array]:
    content = read_bytes(path, MAX_BYTES)
    try:
        file = pq.ParquetFile(pa.BufferReader(content))
        shape = file.metadata.num_rows, file.metadata.num_columns
        if not FEWEST <= shape[0] <= MAX_CARS or not 1 <= shape[1] <= MAX_NAMES:
            raise ValueError(f"{shape[0]} cars of {shape[1]} parameters; some were expected")
        types = {field.name: field.type for field in file.schema_arrow}
        if len(types) < shape[1] or not all(map(pa.types.is_floating, types.values())):
            raise ValueError("columns of numbers with names of their own were expected")
        table = as_frame(file.read(use_threads=False))
        cars = {str(name): table[name].to_numpy(dtype=np.float64) for name in table.columns}
    except (pa.ArrowException, OSError, ValueError, TypeError, KeyError) as error:
        raise VehicleError(f"{path}: is damaged ({' '.join(str(error).split())}); identify again") from error
    if not all(np.isfinite(each).all() for each in cars.values()):
        raise VehicleError(f"{path}: holds numbers that are not finite; identify again")
    return cars
