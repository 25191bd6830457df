"""A short drive of a car with known effects, as a log."""

from typing import Any

import pytest

from racerl.assemble import conf_folder
from racerl.config import compose_settings
from racerl.data.log import Log
from racerl.estimation.unknowns import choose_unknowns
from racerl.gap import investigation
from racerl.gap.catalogue import starts
from racerl.gap.evidence import Evidence
from racerl.gap.investigation import Investigation
from racerl.gap.stage import CHASSIS, DRIVE, STEERING
from racerl.record.record import Plan, table
from racerl.vehicle import catalogue
from racerl.vehicle.load import load_vehicle
from racerl.vehicle.vehicle import Vehicle


def drive(*overrides: str, seconds: float = 60.0) -> Log:
    """Return what the sensors of a car show of the excitation programme."""
    settings = compose_settings("record", ["vehicle=published", f"seconds={seconds}", *overrides])
    return Log.from_table("drive", table(Plan.of(settings).drive(), **settings["smoothing"]))


def configured() -> tuple[Vehicle, dict[str, Any]]:
    """Return the car that made the logs, and the priors of a refit."""
    settings = compose_settings("identify", ["vehicle=published", "logs=[drive]"])
    return load_vehicle(settings["vehicle"]), settings["priors"]


def investigate(log: Log, *names: str, vehicle: Vehicle | None = None) -> Investigation:
    """Return an investigation of a log that knows these effects and starts from `vehicle`, else from the right one."""
    right, priors = configured()
    vehicle = vehicle or right
    unknowns = choose_unknowns(vehicle, priors, [], vehicle)
    catalogue = {name: starts(name, conf_folder() / "vehicle" / "effect") for name in names}
    cut = [Evidence.of([log], stage, 85, 0.5) for stage in (STEERING, DRIVE, CHASSIS)]
    return investigation.investigate({each.stage.name: each for each in cut}, vehicle, unknowns, catalogue, threads=2)


def settings_for(log, folder, *names, **changes):
    """Return the settings of a diagnosis that knows some effects only."""
    path = folder / f"{log.name}.parquet"
    log.table.to_parquet(path, index=False)
    without = [name for name in catalogue.names() if name not in names]
    return {**compose_settings("gap", [f"logs=['{path}']", "vehicle=published"]), "without": without, **changes}


@pytest.fixture(scope="session")
def clean() -> Log:
    return drive()


@pytest.fixture(scope="session")
def damped() -> Log:
    return drive("+vehicle/effect=yaw_damping", "vehicle.effects.yaw_damping.coefficient=0.15")
