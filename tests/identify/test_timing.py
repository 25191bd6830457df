"""Sensors that are late or off, and dead times, that the vehicle is given with: undone before a log is compared."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from racerl.config import compose_settings
from racerl.data.log import Log
from racerl.errors import LogError
from racerl.identify.identify import identify
from racerl.identify.timing import aligned
from racerl.record.record import record
from racerl.vehicle.load import load_vehicle
from tests.identify.conftest import FEW, settings_for

LATE = ["+vehicle/effect=wheel_speed_latency", "vehicle.effects.wheel_speed_latency.latency=0.04"]
SKEWED = [
    "+vehicle/effect=[wheel_speed_latency,steering_sensor_offset]",
    LATE[1],
    "vehicle.effects.steering_sensor_offset.offset=0.03",
]


def car(*effects: str):
    words = [f"vehicle.effects.{name.split('=')[0]}" + "=" + name.split("=")[1] for name in effects]
    groups = [f"+vehicle/effect=[{','.join(dict.fromkeys(name.split('.')[0] for name in effects))}]"] if effects else []
    return load_vehicle(compose_settings("record", ["vehicle=published", *groups, *words])["vehicle"])


def drive(rows=(120, 80)) -> Log:
    t = 0.01 * np.arange(sum(rows))
    names = ("v_x", "omega", "delta", "delta_ref", "omega_ref")
    table = {name: 0.5 * np.sin((3.0 + i) * t) for i, name in enumerate(names)}
    return Log.from_table("drive", pd.DataFrame({"t": t, "run": np.repeat(np.arange(len(rows)), rows), **table}))


def test_each_channel_is_read_where_it_belongs():
    log = drive()
    late = {"wheel_speed_latency.latency": 0.034, "pose_latency.latency": 0.01, "steering_delay.delay": 0.025}
    found = aligned(log, car(*(f"{name}={value}" for name, value in late.items())))
    ahead = {"v_x": 0.0, "omega": 0.034 - 0.01, "delta": -0.01, "delta_ref": -0.01 - 0.025, "omega_ref": -0.01}
    for name, seconds in ahead.items():
        i = log.channels.index(name)
        expected = 0.5 * np.sin((3.0 + i) * (found.array("t") + seconds))
        assert found.array(name) == pytest.approx(expected, abs=3e-4), name  # a line between samples, w² dt² / 8
    # what was not logged for every channel is left out, in each run
    assert [len(rows) for rows in found.runs()] == [120 - 4 - 3, 80 - 4 - 3]
    assert found.remarks[-1].startswith("the vehicle's latencies and dead times are undone: ")
    assert "omega 0.024 s late" in found.remarks[-1] and "delta_ref 0.035 s early" in found.remarks[-1]


def test_a_car_without_latencies_leaves_a_log_as_it_is():
    log = drive()
    assert aligned(log, car("steering_sensor_offset.offset=0.03")) is log


def test_runs_that_are_shorter_than_the_latency_are_told():
    with pytest.raises(LogError, match=r"drive: no run is longer .* \(omega 0\.15 s late\)"):
        aligned(drive((10, 12)), car("wheel_speed_latency.latency=0.15"))


@pytest.fixture(scope="module")
def skewed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The log, without commands, of a minute in a car whose wheel speed is late and whose steering sensor is off."""
    out = tmp_path_factory.mktemp("skewed")
    record(compose_settings("record", ["vehicle=published", *SKEWED, "seconds=60", "seed=3"]), out / "drive")
    table = pd.read_parquet(out / "drive" / "log.parquet").drop(columns=["delta_ref", "omega_ref"])
    table.to_parquet(out / "log.parquet")
    return out / "log.parquet"


def test_a_log_is_scored_with_the_sensors_of_the_car(skewed, tmp_path):
    """Each sensor in place brings down the errors that it makes; both leave the noise of the velocities."""
    errors = []
    for number, words in enumerate(
        (["vehicle=published"], ["vehicle=published", *LATE], ["vehicle=published", *SKEWED])
    ):
        rmse = identify(settings_for(skewed, "fit=false", *words), tmp_path / str(number))["rmse"]["85"]
        errors.append([rmse[name] for name in ("v_x", "v_y", "yaw_rate")])
    as_read, in_time, straight = np.array(errors)
    assert in_time[0] < 0.5 * as_read[0] and straight[2] < 0.5 * in_time[2]
    assert (straight < [0.02, 0.02, 0.05]).all(), straight


def test_a_steering_sensors_offset_is_found_and_a_latency_is_not_fitted(skewed, tmp_path):
    facts = identify(settings_for(skewed, FEW, *SKEWED[:2], "folds=0"), tmp_path / "found")
    assert facts["parameters"]["effects.steering_sensor_offset.offset"]["value"] == pytest.approx(0.03, abs=0.002)
    assert "effects.wheel_speed_latency.latency" not in facts["parameters"]
    assert facts["fixed"]["effects.wheel_speed_latency.latency"] == 0.04
