"""A foreign body: CommonRoad's multi-body car at 1:8, by similarity, limits and its seams to the rest."""

import importlib.util
import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import torch

from racerl.assemble import Car, build_action, build_race, build_track
from racerl.config import compose_settings
from racerl.documents import read_yaml
from racerl.errors import RacerlError, VehicleError
from racerl.optimum.floor import problem_hash
from racerl.optimum.kept import found, known
from racerl.record.record import record
from racerl.vehicle.bodies import BodyMotion, commonroad_mb
from racerl.vehicle.bodies.commonroad_mb import CommonroadMb, scaled
from racerl.vehicle.kernel import choose_motion
from racerl.vehicle.load import load_vehicle
from racerl.vehicle.ops import TORCH

BIG = 2.5789128, 1093.2952334674046  # m, kg: CommonRoad's vehicle 2


def settings(*words):
    return compose_settings("evaluate", ["run=x", "car=commonroad_mb", "vehicle=published", *words])


def vehicle(**changes):
    asked = settings()
    return replace(load_vehicle(Car(**asked["car"]).wear(asked["vehicle"])), **changes)


def driven(car, commands, seconds, start):
    """Return what a car shows after each of some commands."""
    own, rows = car.begin(start), []
    for command in commands:
        own = car.advance(own, command, seconds)
        rows.append(car.show(own))
    return np.array(rows)


def test_in_its_own_size_it_is_the_sources_car():
    from vehiclemodels.vehicle_parameters import setup_vehicle_parameters

    ours, theirs = scaled(*BIG), setup_vehicle_parameters(2)
    for name in ("m_s", "a", "I_z", "I_uf", "K_sf", "K_sdr", "K_tsf", "K_rad", "K_lt", "D_f", "R_w"):
        assert getattr(ours, name) == pytest.approx(getattr(theirs, name), rel=1e-7), name


def test_small_and_big_cars_drive_alike():
    """Froude's law: lengths λ, times √λ, whatever the mass."""
    small = vehicle()
    ratio = float(small.wheelbase) / BIG[0]
    slower = {
        name: replace(getattr(small, name), time_constant=getattr(small, name).time_constant / math.sqrt(ratio))
        for name in ("steering", "drive")
    }
    big = replace(small, wheelbase=BIG[0], mass=900.0, **slower)
    commands = [(0.12, 2.6)] * 12 + [(-0.2, 1.5)] * 12
    here = driven(CommonroadMb(small), commands, 0.02, [0.0, 0.0, 0.3, 2.0, 0.0, 0.0, 0.0, 2.0])
    speed = 2.0 / math.sqrt(ratio)
    there = driven(
        CommonroadMb(big),
        [(steering, drive / math.sqrt(ratio)) for steering, drive in commands],
        0.02 / math.sqrt(ratio),
        [0.0, 0.0, 0.3, speed, 0.0, 0.0, 0.0, speed],
    )
    root = math.sqrt(ratio)
    there *= [ratio, ratio, 1.0, root, root, 1.0 / root, 1.0, root]
    assert np.abs(here[:, 2] - 0.3).max() > 0.15  # it turns
    np.testing.assert_allclose(there, here, atol=2e-4)


def test_at_walking_pace_it_turns_as_its_wheels_point():
    car = vehicle()
    rows = driven(CommonroadMb(car), [(0.1, 0.6)] * 40, 0.02, [0.0, 0.0, 0.0, 0.6, 0.0, 0.0, 0.0, 0.6])
    last = rows[-1]
    assert last[5] == pytest.approx(last[3] * math.tan(0.1) / float(car.wheelbase), rel=0.03)
    assert last[7] == pytest.approx(0.6, abs=0.01) and last[6] == pytest.approx(0.1, abs=1e-3)


def test_from_rest_it_drives_off_with_its_wheels():
    rows = driven(CommonroadMb(vehicle()), [(0.0, 1.5)] * 40, 0.02, [0.0] * 8)
    assert rows[-1, 3] == pytest.approx(1.5, abs=0.05) and rows[-1, 0] > 0.8
    assert np.abs(rows[-10:, 7] - rows[-10:, 3]).max() < 0.01


def test_shorter_steps_change_little(monkeypatch):
    asked = [(0.2, 4.0)] * 15, 0.02, [0.0, 0.0, 0.0, 3.0, 0.0, 0.0, 0.0, 3.0]
    coarse = driven(CommonroadMb(vehicle()), *asked)
    monkeypatch.setattr(commonroad_mb, "STEP", 1e-4)
    np.testing.assert_allclose(coarse, driven(CommonroadMb(vehicle()), *asked), atol=5e-5)


def test_a_car_that_is_put_elsewhere_begins_there_and_the_others_go_on():
    motion = BodyMotion(vehicle(), (), 0.02)
    state = torch.zeros(8, 2)
    state[[3, 7]] = torch.tensor([1.0, 2.0])
    command, none = torch.tensor([[0.1, -0.1], [1.0, 2.0]]), torch.zeros(0, 2)
    for _ in range(2):
        state = motion(state, command, none)
    alone = BodyMotion(vehicle(), (), 0.02)
    kept = state.clone()
    state[:, 1] = torch.tensor([3.0, 4.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0])
    moved = motion(state, command, none)
    fresh = alone(state[:, 1:], command[:, 1:], none)
    torch.testing.assert_close(moved[:, 1:], fresh, rtol=0, atol=0)
    torch.testing.assert_close(moved[:, :1], motion_of_the_first(kept, command), rtol=0, atol=0)


def motion_of_the_first(kept, command):
    """The first car driven alone through the same three steps."""
    alone, state = BodyMotion(vehicle(), (), 0.02), torch.zeros(8, 1)
    state[[3, 7]] = 1.0
    for _ in range(3):
        state = alone(state, command[:, :1], torch.zeros(0, 1))
    return state


@pytest.mark.parametrize("v_x, v_y, yaw_rate", [(0.3, 0.0, 8.0), (-1.0, 0.0, 1.0), (1.0, 3.0, 12.0)])
def test_what_its_source_has_no_answer_for_is_a_failed_car_and_ends_nothing(v_x, v_y, yaw_rate):
    motion = BodyMotion(vehicle(), (), 0.02)
    state = torch.tensor([[0.0, 0.0, 0.0, v_x, v_y, yaw_rate, 0.0, 1.0], [0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 2.0]]).T
    moved = motion(state, torch.tensor([[0.3, 0.0], [1.0, 2.0]]), torch.zeros(0, 2))
    assert bool(moved[:, 0].isnan().all()) and bool(moved[:, 1].isfinite().all())
    again = motion(torch.where(moved.isnan(), state[:, 1:], moved), torch.zeros(2, 2), torch.zeros(0, 2))
    assert bool(again.isfinite().all())  # started over, as a race does


def test_effects_of_sensors_and_delays_go_with_it_and_no_body_is_none():
    asked = settings()["vehicle"] | {"body": "commonroad_mb"}
    shown = {"steering_sensor_offset": {"offset": 0.02}, "steering_delay": {"delay": 0.02}}
    assert BodyMotion(load_vehicle(asked | {"effects": shown}), (), 0.02)
    assert load_vehicle(asked | {"body": None}).body == ""


def test_it_races(tmp_path):
    asked = settings()
    asked = {**compose_settings("train"), "vehicle": Car(**asked["car"]).wear(asked["vehicle"])}
    race = build_race({**asked, "dr": {"sigma": 0.0, "parameters": []}}, cars=2, seeds=[0, 1])
    before = race.state.clone()
    for _ in range(3):
        race.step(torch.tensor([[0.5, 1.0], [-0.5, 1.0]]))
    assert race.faults == 0 and bool((race.state[7] > before[7]).all())
    assert float(race.state[6, 0]) > 0.02 and float(race.state[6, 1]) < -0.02
    plain = load_vehicle(asked["vehicle"] | {"body": ""})
    assert problem_hash(race.vehicle, race.track, race.action) != problem_hash(plain, race.track, race.action)


def test_no_least_lap_is_known_of_it_and_that_ends_nothing(caplog):
    asked = settings()
    track, action = build_track(asked | {"track": {"file": "oval.csv"}}), build_action(compose_settings("train"))
    assert known(vehicle(), track, action) is None and found(vehicle(), track, action) is None
    assert "of body commonroad_mb no least lap time is known" in caplog.text


def test_where_its_equations_end_it_is_stood_up_and_a_new_run_begins(tmp_path, monkeypatch, caplog):
    honest, calls = BodyMotion.advance, []

    def advance(self, car, state, command):
        calls.append(state.copy())
        moved = honest(self, car, state, command)
        return moved * float("nan") if len(calls) == 30 else moved

    monkeypatch.setattr(BodyMotion, "advance", advance)
    words = ["vehicle=published", "car=commonroad_mb", "drive=race", "seconds=1", "rate=50"]
    record(compose_settings("record", words), tmp_path / "a")
    log = pd.read_parquet(tmp_path / "a" / "log.parquet")
    assert log["run"].tolist() == [0] * 30 + [1] * 20 and np.isfinite(log.select_dtypes("number")).all(axis=None)
    np.testing.assert_array_equal(calls[30], [*calls[29][:3], *[0.0] * 5])  # it stands where it was
    assert log["omega"].iloc[-1] > 0.05 and "stood up there" in caplog.text


def test_it_is_recorded_and_says_so(tmp_path):
    record(
        compose_settings("record", ["vehicle=published", "car=commonroad_mb", "drive=race", "seconds=1", "rate=50"]),
        tmp_path / "a",
    )
    log = pd.read_parquet(tmp_path / "a" / "log.parquet")
    assert len(log) == 50 and log["omega"].iloc[-5:].mean() > 0.3
    assert read_yaml(tmp_path / "a" / "vehicle.yaml")["body"] == "commonroad_mb"


@pytest.mark.parametrize(
    "broken, said",
    [
        (lambda: vehicle().derivative(torch.zeros(8, 1), torch.zeros(2, 1), TORCH), "not fitted, optimised"),
        (lambda: BodyMotion(vehicle(), ["friction"], 0.02), "friction cannot be drawn"),
        (lambda: BodyMotion(vehicle().without_actuators(), (), 0.02), "give sim=default"),
        (lambda: choose_motion(vehicle(), (), 0.01, 2, torch.device("cuda"), torch.float32), "give device=cpu"),
        (lambda: load_vehicle(settings()["vehicle"] | {"body": "commonroad"}), "did you mean commonroad_mb"),
        (
            lambda: BodyMotion(
                load_vehicle(
                    settings("+vehicle/effect=yaw_damping")["vehicle"]
                    | {"body": "commonroad_mb", "effects": {"yaw_damping": {"coefficient": 0.1}}}
                ),
                (),
                0.02,
            ),
            "yaw_damping acts on the single-track car",
        ),
    ],
)
def test_what_it_cannot_do_is_told(broken, said):
    with pytest.raises(RacerlError, match=said):
        broken()


def test_without_its_package_it_says_what_to_install(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(VehicleError, match=r"pip install -e '\.\[commonroad\]'"):
        BodyMotion(vehicle(), (), 0.02)
