"""The evaluate stage on a real (if poor) policy."""

import json
import shutil

import numpy as np
import pandas as pd
import pytest
import torch
import yaml

from racerl.assemble import Car, conf_folder
from racerl.config import compose_settings
from racerl.env.termination import Crash
from racerl.errors import RacerlError, RunError
from racerl.evaluate.drive import Recorder, drive
from racerl.evaluate.evaluate import combine, evaluate, label
from racerl.record.record import record
from racerl.registry import construct
from racerl.vehicle.load import load_vehicle
from racerl.vehicle.parameter import replace_values
from tests.env.test_race import make
from tests.vehicle.test_f1tenth_gym import gym


class Follower:
    """Steers back to the centreline and holds a walking pace: slow, but laps."""

    name = "follower"

    def act(self, race):
        curvature = race.frame.lookup(race.s + 0.2, race.frame.curvature)[0]
        steering = 0.33 * curvature - 1.2 * race.n - 1.0 * race.heading
        return torch.stack([steering / 0.5, (1.2 - race.omega)], dim=1)


def test_a_known_driver_gets_known_laps():
    race = make("sim.max_steps=1000000", cars=2, seeds=[0, 1], termination=Crash())
    recorder = Recorder(race, [0, 1])
    laps = drive(race, Follower(), 2, recorder)
    assert len(laps) == 4 and all(lap.valid for lap in laps)
    log = recorder.log()
    for lap in laps:
        rows = log[(log["seed"] == lap.car) & (log["lap"] == lap.number)]
        # an independent clock: the distance driven at the recorded speeds
        assert len(rows) * 0.05 == pytest.approx(lap.time_s, abs=0.1)
        driven = np.hypot(rows["v_x"], rows["v_y"]).sum() * 0.05
        assert driven == pytest.approx(race.track.length, rel=0.03)
        assert lap.time_s == pytest.approx(race.track.length / 1.2, rel=0.05)


def test_the_log_is_a_drive_log():
    race = make("sim.max_steps=1000000", cars=1, termination=Crash())
    recorder = Recorder(race, [0])
    drive(race, Follower(), 1, recorder)
    log = recorder.log()
    assert {"t", "run", "x", "y", "yaw", "v_x", "v_y", "yaw_rate", "delta", "omega", "delta_ref", "omega_ref"} <= set(
        log
    )
    for _, run in log.groupby("run"):
        assert np.allclose(run["t"].diff().dropna(), 0.05)
    step = log[log["run"] == log["run"].iloc[0]]
    travelled = np.hypot(step["x"].diff(), step["y"].diff()).dropna()
    speed = np.hypot(step["v_x"], step["v_y"])
    assert np.allclose(travelled / 0.05, (speed + speed.shift(-1))[:-1] / 2, atol=0.05)


def test_a_car_that_creeps_is_given_up(caplog):
    class Creeper:
        name = "creeper"

        def act(self, race):
            return torch.stack(
                [
                    0.66 * race.frame.lookup(race.s + 0.1, race.frame.curvature)[0] - 2.4 * race.n - 2.0 * race.heading,
                    5 * (0.15 - race.omega),
                ],
                dim=1,
            )

    race = make("sim.max_steps=1000000", cars=1, termination=Crash())
    assert drive(race, Creeper(), 1) == [] and "given up" in caplog.text


def test_metrics_and_files(smoke_evaluation):
    metrics = json.loads((smoke_evaluation / "metrics.json").read_text())
    for key in (
        "laps",
        "fastest_valid_lap_s",
        "mean_lap_s",
        "std_lap_s",
        "e_off",
        "crash_share",
        "max_off_track_m",
        "rows",
        "car",
        "controller",
        "seed",
        "git_sha",
    ):
        assert key in metrics
    assert metrics["laps"] == len(metrics["rows"]) == 4 and metrics["car"] == "model"
    assert {row["seed"] for row in metrics["rows"]} == {0, 1}
    drive_log = pd.read_parquet(smoke_evaluation / "trajectories.parquet")
    assert set(drive_log["seed"]) == {0, 1} and np.isfinite(drive_log.to_numpy()).all()


def test_a_seed_gives_the_same_laps_alone(smoke_run, smoke_evaluation, tmp_path):
    evaluate(compose_settings("evaluate", [f"run='{smoke_run}'", "laps=2", "seeds=[1]"]), tmp_path / "alone")
    alone = json.loads((tmp_path / "alone" / "metrics.json").read_text())["rows"]
    both = json.loads((smoke_evaluation / "metrics.json").read_text())["rows"]
    assert [row["e_off"] for row in alone] == pytest.approx(
        [row["e_off"] for row in both if row["seed"] == 1], rel=1e-4
    )


def raced(trained, *words):
    settings = compose_settings("evaluate", ["run=x", *words])
    return combine(trained, settings, construct(Car, settings["car"], "car"))


def test_the_driven_car_has_actuators_whatever_it_was_trained_with():
    trained = compose_settings("train", ["sim=no_actuators", "dr=all_0.1"])
    plain = raced(trained)
    assert plain["sim"]["actuators"] is True and plain["dr"]["sigma"] == 0.0
    assert raced(trained, "sim=no_actuators")["sim"]["actuators"] is False
    assert raced(trained, "dr=friction_0.1")["dr"]["sigma"] == 0.1
    assert "no actuator model" in label(trained) and "all σ = 0.1" in label(trained)


def test_a_motor_keeps_its_small_step_in_any_car():
    trained = compose_settings("train", ["sim=motor_current", "action=current"])
    assert raced(trained, "car=twin")["sim"]["step"] == trained["sim"]["step"] == 0.001
    assert raced(compose_settings("train", []), "car=twin")["sim"]["step"] == 0.005


def test_the_twin_is_the_vehicle_with_what_training_never_sees():
    trained = compose_settings("train", ["vehicle=published", "+vehicle/effect=aero_drag"])
    twin = raced(trained, "car=twin")
    assert {"aero_drag", "drive_delay", "pose_latency"} <= set(twin["vehicle"]["effects"])
    assert (
        twin["vehicle"]["l_f"] == trained["vehicle"]["l_f"] and "wheel_speed_latency" not in twin["vehicle"]["effects"]
    )
    assert twin["sim"]["step"] < trained["sim"]["step"] and twin["dr"]["each_lap"] and twin["dr"]["sigma"] > 0
    assert "drive_delay" not in raced(trained, "car=twin", "~car.effects.drive_delay")["vehicle"]["effects"]


def test_the_twin_of_the_default_car_has_the_numbers_of_its_log():
    own = compose_settings("train", ["vehicle=f1tenth_twin"])["vehicle"]
    for words in ([], ["+vehicle/effect=aero_drag"]):
        trained = compose_settings("train", words)
        twin = raced(trained, "car=twin")["vehicle"]
        assert {**twin, "effects": {}} == {**own, "effects": {}} and own["yaw_inertia"] != trained["vehicle"][
            "yaw_inertia"
        ]
        assert {*own["effects"], *trained["vehicle"]["effects"], "steering_delay"} <= set(twin["effects"])
    heavier = raced(compose_settings("train", ["vehicle.mass=6"]), "car=twin")["vehicle"]
    assert heavier["mass"] == 6 and heavier["yaw_inertia"] != own["yaw_inertia"]


def test_a_floor_with_less_grip_is_all_that_a_slippery_twin_adds(tmp_path):
    document = compose_settings("train", ["vehicle=published", "+vehicle/effect=yaw_damping"])["vehicle"]
    (tmp_path / "mine.yaml").write_text(yaml.safe_dump(document))
    for words in (["vehicle=published"], [f"vehicle={tmp_path / 'mine.yaml'}"], []):
        trained = compose_settings("train", words)
        twin, slippery = (load_vehicle(raced(trained, f"car={car}")["vehicle"]) for car in ("twin", "twin_slippery"))
        assert slippery.friction == pytest.approx(0.9 * twin.friction)
        assert replace_values(slippery, {"friction": twin.friction}) == twin
        assert ("yaw_damping" in slippery.effects) is bool(words and "mine" in words[0])


BODIES = {"commonroad_mb": pytest.mark.slow, "f1tenth_gym": gym}


@pytest.mark.parametrize(
    "car",
    [
        pytest.param(name, marks=[BODIES[name]] if name in BODIES else [])
        for name in sorted(path.stem for path in (conf_folder() / "car").glob("*.yaml"))
    ],
)
def test_every_car_is_raced_and_recorded(car, smoke_run, tmp_path):
    metrics = evaluate(compose_settings("evaluate", [f"run='{smoke_run}'", f"car={car}", "laps=1"]), tmp_path / "race")
    assert metrics["car"] == car and metrics["laps"] == 3
    facts = record(compose_settings("record", [f"car={car}", "vehicle=published", "seconds=5"]), tmp_path / "log")
    assert facts["rows"] == 500


@pytest.mark.parametrize(
    "override, said",
    [
        ("laps=0", "laps"),
        ("laps=1.5", "laps"),
        ("seeds=[]", "seeds"),
        ("seeds=[-1]", "seeds"),
        ("run=nowhere", "no racerl run"),
        ("threads=0", "threads"),
        ("+car.estimate.speed=0.1", "no state 'speed'"),
        ("+car.estimate.v_x=-1", "car.estimate.v_x = -1"),
        ("+car.effects.wings={}", "wings"),
        ("+car.wheels=3", "no setting 'wheels'"),
    ],
)
def test_wrong_settings(override, said, smoke_run, tmp_path):
    with pytest.raises(RacerlError, match=said):
        evaluate(compose_settings("evaluate", [f"run='{smoke_run}'", override]), tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_an_evaluation_is_no_policy(smoke_evaluation, tmp_path):
    with pytest.raises(RunError, match="a train run was expected"):
        evaluate(compose_settings("evaluate", [f"run='{smoke_evaluation}'"]), tmp_path / "out")


@pytest.mark.parametrize(
    "old, new",
    [
        ("sim:", "smi:"),
        ("name: geometric", "nome: geometric"),
        ("sigma: 0.02", "sigma: much"),
        ("dt: 0.05", "dt: soon"),
        ("drive: wheel_speed", "drive: [x]"),
        ("file: l_shape.csv", "file: 3"),
        ("mass: 5.1", "mass: {}"),
    ],
)
def test_a_tampered_run_only_raises_typed_errors(smoke_run, tmp_path, old, new):
    copy = tmp_path / "copy"
    shutil.copytree(smoke_run, copy)
    text = (copy / "config.yaml").read_text()
    assert old in text
    (copy / "config.yaml").write_text(text.replace(old, new))
    with pytest.raises(RacerlError) as error:
        evaluate(compose_settings("evaluate", [f"run='{copy}'"]), tmp_path / "out")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    "key, change, said",
    [
        ("observation", {"points": 10}, "reads 50 numbers"),
        ("observation", {"name": "os.system"}, "unknown observation"),
        ("observation", {"width_max": "wide"}, "width_max"),
        ("action", {"name": "sped"}, "speed"),
        ("action", {"power": 9}, "no setting"),
    ],
)
def test_a_policy_that_does_not_fit_is_refused(smoke_run, tmp_path, key, change, said):
    copy = tmp_path / "copy"
    shutil.copytree(smoke_run, copy)
    facts = json.loads((copy / "policy.json").read_text())
    facts[key] |= change
    (copy / "policy.json").write_text(json.dumps(facts))
    with pytest.raises(RacerlError, match=said):
        evaluate(compose_settings("evaluate", [f"run='{copy}'"]), tmp_path / "out")
    assert not (tmp_path / "out").exists()
