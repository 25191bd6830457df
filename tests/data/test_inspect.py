"""The inspection: every trap is seen on a log made to show it, none on clean ones; the measured logs show theirs."""

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.signal import butter, filtfilt

import racerl.data.inspect
from racerl.data.inspect import compare, inspect, noise
from racerl.data.load import load_logs
from racerl.data.log import Log
from tests.data.conftest import mapping, measured, simulate


def warnings(table: pd.DataFrame, wheelbase: float = 0.33) -> list[str]:
    return inspect(Log.from_table("drive", table), wheelbase)["warnings"]


def moved(table: pd.DataFrame, name: str, rows: int) -> pd.DataFrame:
    """Return the table with a channel late by that many rows, run by run."""
    late = [np.roll(run[name], rows) for _, run in table.groupby("run", sort=False)]
    return table.assign(**{name: np.concatenate(late)})


@pytest.mark.parametrize("top", [2.5, 4.5])
@pytest.mark.parametrize(
    "overrides", [(), ("vehicle=f1tenth",), ("vehicle.friction=0.5",), ("+vehicle/effect=tyre_relaxation",)]
)
def test_clean_logs_raise_no_warning(overrides, top):
    facts = inspect(Log.from_table("drive", simulate(overrides, seed=3, top=top)))
    assert facts["warnings"] == []
    json.dumps(facts, allow_nan=False)


def test_facts_of_a_clean_log(driven):
    facts = inspect(Log.from_table("drive", driven))
    assert facts["rate_hz"] == 100 and facts["seconds"] == 60 and len(facts["runs"]) == 3 and len(facts["gaps"]) == 2
    assert facts["missing"] == ["current"]
    assert facts["channels"]["omega"]["noise"] == pytest.approx(0.03, rel=0.1)
    assert facts["channels"]["delta_ref"]["updates_hz"] == pytest.approx(20, abs=0.5)
    assert facts["lags"]["delta"]["seconds"] == pytest.approx(0.0, abs=0.011)
    assert facts["lags"]["delta_ref"]["seconds"] == pytest.approx(0.044, abs=0.02)
    assert set(facts["coverage"]) == {"speed", "slip_angle", "slip_ratio", "a_x", "a_y"}
    seconds = sum(facts["coverage"]["speed"]["seconds"])
    assert 58 < seconds <= 60


def test_other_tyres_move_the_lag_of_the_steering_by_less_than_the_limit_of_a_warning():
    lags = inspect(Log.from_table("drive", simulate(("vehicle=f1tenth",), seed=3)))["lags"]
    assert abs(lags["delta"]["seconds"]) <= 0.031 and 0.01 <= lags["delta_ref"]["seconds"] <= 0.05


def test_noise_is_what_was_added():
    dice = np.random.default_rng(0)
    t = np.arange(0.0, 30.0, 0.01)
    table = pd.DataFrame(
        {"t": t, "v_x": 2 + np.sin(t) + 0.05 * dice.standard_normal(len(t)), "yaw": np.angle(np.exp(1j * t))}
    )
    assert noise(Log.from_table("a", table), "v_x") == pytest.approx(0.05, rel=0.05)
    assert noise(Log.from_table("a", table), "yaw") < 1e-6


def test_noise_of_a_filtered_channel_is_what_the_filter_left():
    dice = np.random.default_rng(0)
    t = np.arange(0.0, 60.0, 0.01)
    left = filtfilt(*butter(2, 15.0, fs=100.0), 0.05 * dice.standard_normal(len(t)))
    table = pd.DataFrame({"t": t, "v_x": 2 + np.sin(t) + left})
    assert noise(Log.from_table("a", table), "v_x") == pytest.approx(left.std(), rel=0.2)
    table["v_x"] = np.round(table["v_x"])  # held for most of the time
    assert noise(Log.from_table("a", table), "v_x") is None


def test_noise_of_runs_too_short_to_tell_is_not_known():
    table = pd.DataFrame({"t": np.arange(0.0, 0.1, 0.01), "v_x": np.random.default_rng(0).standard_normal(10)})
    assert noise(Log.from_table("a", table), "v_x") is None


@pytest.mark.parametrize("rows", [-12, -8, 8, 12])
@pytest.mark.parametrize("name", ["delta", "delta_ref"])
def test_a_shifted_steering_channel_is_seen_with_sign_and_size(driven, name, rows):
    facts = inspect(Log.from_table("drive", moved(driven, name, rows)))
    own = 0.0 if name == "delta" else 0.044
    assert facts["lags"][name]["seconds"] == pytest.approx(own - 0.01 * rows, abs=0.02)
    said = [line for line in facts["warnings"] if line.startswith(f"{name} is")]
    assert len(said) == (0 if own - 0.01 * rows > -0.035 and rows > 0 else 1)
    assert all(("behind" if rows > 0 else "ahead") in line for line in said)


@pytest.mark.parametrize("rows", [-12, 12])
def test_a_shifted_wheel_speed_is_seen(driven, rows):
    said = [line for line in warnings(moved(driven, "omega", rows)) if line.startswith("omega is")]
    assert len(said) == 1 and ("behind" if rows > 0 else "ahead") in said[0]


@pytest.mark.parametrize("rows", [-9, 9])
def test_a_shifted_current_is_seen(driven, rows):
    log = Log.from_table("drive", driven)
    torque = np.concatenate([np.gradient(np.convolve(run["v_x"], np.ones(15) / 15, "same")) for run in log.runs()])
    table = moved(driven.assign(current=1000 * torque - 10 * driven["v_y"] * driven["yaw_rate"]), "current", rows)
    said = [line for line in warnings(table) if line.startswith("current is")]
    assert len(said) == 1 and ("behind" if rows > 0 else "ahead") in said[0]


def test_velocities_later_than_their_poses_are_seen(driven):
    late = driven
    for name in ("v_x", "v_y", "yaw_rate"):
        late = moved(late, name, 7)
    assert any("yaw_rate lags the differentiated yaw by 0.070 s" in line for line in warnings(late))


def test_velocities_of_another_point_are_seen(driven):
    said = warnings(driven.assign(v_y=driven["v_y"] - 0.13 * driven["yaw_rate"]))
    assert any("0.13 m behind" in line or "0.12 m behind" in line or "0.14 m behind" in line for line in said)


TRAPS = {
    "constant": (lambda t: t.assign(omega_ref=2.0), "omega_ref is constant"),
    "held": (lambda t: t.assign(omega=np.repeat(t["omega"].to_numpy()[::10], 10)), "omega is held between updates"),
    "clipped": (lambda t: t.assign(yaw_rate=t["yaw_rate"].clip(-0.8, 0.8)), "yaw_rate is clipped"),
    "steering sign": (lambda t: t.assign(delta=-t["delta"]), "delta and yaw_rate have opposite signs"),
    "yaw rate sign": (lambda t: t.assign(yaw_rate=-t["yaw_rate"]), "yaw_rate has the opposite sign"),
    "wheel sign": (lambda t: t.assign(omega=-t["omega"]), "omega has the opposite sign of v_x"),
    "wheel in rad/s": (lambda t: t.assign(omega=t["omega"] / 0.055), "rad/s of a small wheel"),
    "wheel in km/h": (lambda t: t.assign(omega=t["omega"] * 3.6), "omega in km/h?"),
    "commanded speed": (lambda t: t.assign(omega_ref=t["omega_ref"] * 3.6), "omega_ref is 3.5"),
    "limited": (lambda t: t.assign(omega_ref=9.0), "the car is limited, or"),
    "steering in percent": (lambda t: t.assign(delta=t["delta"] / 10), "times v_x tan"),
    "v_x in km/h": (lambda t: t.assign(v_x=t["v_x"] * 3.6), "pose: v_x in km/h?"),
    "x and y in mm": (lambda t: t.assign(x=1000 * t["x"], y=1000 * t["y"]), "pose: x and y in mm?"),
    "yaw rate in degrees": (
        lambda t: t.assign(yaw_rate=np.degrees(t["yaw_rate"]) / 3),
        "times the differentiated pose",
    ),
    "axes mixed": (lambda t: t.assign(v_x=t["v_y"] + 2, v_y=t["v_x"]), "does not follow the differentiated pose"),
    "doubled run": (
        lambda t: pd.concat([t, t[t["run"] == 1].assign(run=9, t=lambda r: r["t"] + 500)]),
        "20.0 s of driving are in the log twice",
    ),
}


@pytest.mark.parametrize("trap", TRAPS)
def test_each_trap_is_seen(driven, trap):
    spoil, said = TRAPS[trap]
    found = warnings(spoil(driven))
    assert any(said in line for line in found), found
    assert all("\n" not in line for line in found)


def test_a_heading_in_degrees_is_said_once_and_contradicts(driven):
    facts = inspect(Log.from_table("drive", driven.assign(yaw=np.degrees(driven["yaw"]))))
    assert facts["contradictions"] == [line for line in facts["warnings"] if "pose" in line]
    assert [line.split(": ")[-1] for line in facts["contradictions"]] == ["yaw in deg?"]
    assert inspect(Log.from_table("drive", driven))["contradictions"] == []


def test_logs_that_share_driving_are_seen(driven):
    first, second = (Log.from_table(name, driven[driven["run"] <= k]) for name, k in (("a", 1), ("b", 0)))
    other = Log.from_table("c", simulate(seed=8, runs=1))
    assert compare([first, other]) == []
    assert compare([first, second, other]) == ["a and b share 20.0 s of identical rows; keep one"]


@pytest.mark.parametrize(
    "columns", [["v_x"], ["x", "y"], ["current"], ["delta", "omega"], ["yaw_rate"], ["v_x", "omega"]]
)
def test_partial_and_short_logs_are_inspected(driven, columns):
    table = driven.assign(current=1.0)[["t", "run", *columns]]
    for rows in (2, 5, 60, 6000):
        json.dumps(inspect(Log.from_table("drive", table.iloc[:rows])), allow_nan=False)


def seen(file: str, name: str, **changes) -> tuple[dict, list[str]]:
    settings = {**mapping(name), **changes}
    facts = inspect(load_logs([measured(file)], settings)[0], settings["vehicle"]["wheelbase"])
    return facts["lags"], facts["warnings"]


@pytest.mark.parametrize("file", ["put/tyre_a.csv.gz", "put/tyre_d.csv.gz"])
def test_put_commands_and_currents_lead_the_motion(file):
    lags, said = seen(file, "put")
    assert 0.06 <= lags["delta_ref"]["seconds"] <= 0.11 and 0.08 <= lags["current"]["seconds"] <= 0.11
    assert sum("another clock" in line for line in said) == 2 == len(said)


def test_put_velocities_are_late_and_made_anew_from_the_poses():
    lags, said = seen("put/lab_drive.csv.gz", "put", velocities="columns")
    assert lags["yaw to yaw_rate"]["seconds"] == pytest.approx(0.07, abs=0.011) and len(said) == 4
    lags, said = seen("put/lab_drive.csv.gz", "put")
    assert abs(lags["delta"]["seconds"]) <= 0.02 and said == []


@pytest.mark.parametrize("name", ["free_driving_10_01_01", "free_driving_10_12_05", "throttle_ramp_rubber"])
def test_dart_values_are_held(name):
    assert any("omega is held" in line for line in seen(f"dart/{name}.csv.gz", "dart")[1])


def test_dart_steering_that_never_moves_is_constant():
    assert any("delta_ref is constant" in line for line in seen("dart/steering_steps_10_02_32.csv.gz", "dart")[1])


def test_the_measured_bag_has_one_clock():
    lags, said = seen("put/tyre_a_rosbag2.zip", "ros2")
    assert abs(lags["current"]["seconds"]) <= 0.02 and said == []
    assert 0.05 <= lags["delta_ref to curvature"]["seconds"] <= 0.09


def test_a_long_log_is_searched_for_lags_in_a_share_of_its_minutes(driven, monkeypatch):
    late = Log.from_table("late", moved(driven, "delta", 6))
    whole = inspect(late)["lags"]["delta"]
    monkeypatch.setattr("racerl.data.inspect.LONG", 0.4 * late.seconds)
    seen = []
    lag = racerl.data.inspect.steering_lag
    monkeypatch.setattr(
        "racerl.data.inspect.steering_lag", lambda log, *others: seen.append(len(log.table)) or lag(log, *others)
    )
    part = inspect(late)["lags"]["delta"]
    assert 0.2 * len(late.table) < seen[0] < 0.6 * len(late.table)
    assert part["seconds"] == pytest.approx(whole["seconds"], abs=0.011)


@pytest.mark.parametrize("given", [0.0, 0.05])
def test_the_shift_that_is_advised_counts_what_was_shifted_before(driven, given):
    log = replace(Log.from_table("drive", moved(driven, "delta", 12)), shift={"delta": given})
    line = next(line for line in inspect(log)["warnings"] if line.startswith("delta is 0.1"))
    asked = float(line.split("data.shift.delta=")[1].split()[0])
    assert asked == pytest.approx(given - 0.12, abs=0.011)


def test_a_shift_at_the_edge_of_the_search_is_no_measurement(driven):
    found = warnings(moved(driven, "delta", 26))
    assert any("delta is 0.25 s or more behind" in line and "look for the shift with" in line for line in found), found


def test_rounded_rows_that_are_alike_by_chance_are_not_driven_twice(driven):
    rounded = driven[["t", "run", "v_x", "yaw_rate"]].round({"v_x": 1, "yaw_rate": 1})
    first, second = (Log.from_table(name, rows) for name, rows in (("a", rounded[:3000]), ("b", rounded[3000:])))
    assert not any("twice" in line for line in inspect(first)["warnings"]) and compare([first, second]) == []


POSES = {
    "y mirrored": (lambda t: t.assign(y=-t["y"]), "turned the other way round"),
    "x and y exchanged": (lambda t: t.assign(x=t["y"], y=t["x"]), "x and y exchanged"),
    "a compass": (lambda t: t.assign(yaw=np.pi / 2 - t["yaw"]), "clockwise from y"),
    "degrees": (lambda t: t.assign(yaw=np.degrees(t["yaw"])), "yaw in deg"),
    "a quarter turn": (lambda t: t.assign(yaw=t["yaw"] + np.pi / 2), "add -1.5"),
    "half a turn": (lambda t: t.assign(yaw=t["yaw"] + np.pi), "points backwards while omega is forwards"),
}


@pytest.mark.parametrize("fault", POSES)
def test_a_pose_that_does_not_move_the_way_it_points_is_told_without_velocities_too(driven, fault):
    spoil, said = POSES[fault]
    found = warnings(spoil(driven[["t", "run", "x", "y", "yaw", "omega"]]))
    assert any("heading" in line and said in line for line in found), found
    assert not any("heading" in line for line in warnings(driven))


@pytest.mark.parametrize(
    ("fault", "said"),
    [({"omega": 1.3}, "omega is 1.29 times v_x"), ({"delta_ref": -1.0}, "delta_ref and yaw_rate have opposite")],
)
def test_a_channel_of_another_scale_is_not_told_to_be_late(driven, fault, said):
    found = warnings(driven.assign(**{name: scale * driven[name] for name, scale in fault.items()}))
    assert any(said in line for line in found) and not any("data.shift" in line for line in found), found


def test_a_car_that_never_drives_on_is_not_checked_and_that_is_said(driven):
    found = warnings(driven.assign(v_x=0.1 * driven["v_x"]))
    assert "it hardly drives forwards faster than 0.8 m/s: signs, units and lags are not checked" in found


def test_velocities_along_the_worlds_axes_are_told_without_poses(driven):
    v_x, v_y, yaw = (driven[name] for name in ("v_x", "v_y", "yaw"))
    world = driven.assign(v_x=v_x * np.cos(yaw) - v_y * np.sin(yaw), v_y=v_x * np.sin(yaw) + v_y * np.cos(yaw))
    found = warnings(world.drop(columns=["x", "y", "yaw"]))
    assert any("v_x does not follow omega" in line for line in found), found
    assert not any("does not follow omega" in line for line in warnings(driven))
