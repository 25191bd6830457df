"""The recorded log: its noise, its kinematics, its files and the hidden car behind it."""

import numpy as np
import pandas as pd
import pytest

from racerl.config import compose_settings
from racerl.data.differentiate import velocities
from racerl.data.log import Log
from racerl.documents import read_yaml
from racerl.errors import RacerlError, RunError
from racerl.record.hidden import Hidden
from racerl.record.record import VEHICLE, record
from racerl.record.sensors import Sensors
from racerl.vehicle.load import load_vehicle, vehicle_document
from racerl.vehicle.parameter import values
from tests.record.conftest import drive

SHORT = ["drive=race", "seconds=3"]
QUIET = [f"car.sensors.{name}=0" for name in ("position", "yaw", "delta", "omega", "current")]


def test_the_noise_is_what_was_asked_for(programme):
    recording, _ = programme
    error = recording.measured[:, :5] - recording.truth[:, [0, 1, 2, 6, 7]]
    assert error.std(axis=0) == pytest.approx([0.0005, 0.0005, 0.001, 0.002, 0.01], rel=0.02)
    assert np.abs(error.mean(axis=0) / error.std(axis=0)).max() < 0.02


def test_sensors_can_be_perfect():
    recording, log = drive(*SHORT, *QUIET)
    assert np.array_equal(log[["x", "y", "yaw", "delta", "omega"]], recording.truth[:, [0, 1, 2, 6, 7]])


def test_sensors_show_their_flaws_while_the_car_stays_the_same():
    flaws = ["lever_arm", "wheel_speed_gain", "pose_latency"]
    words = ["lever_arm.forward=0.1", "lever_arm.left=0.0", "wheel_speed_gain.gain=1.05", "pose_latency.latency=0.025"]
    true, plain = drive(*SHORT, *QUIET)
    same, log = drive(
        *SHORT, *QUIET, f"+vehicle/effect=[{','.join(flaws)}]", *(f"vehicle.effects.{word}" for word in words)
    )
    assert np.array_equal(same.truth, true.truth)
    assert np.allclose(log["omega"], 1.05 * plain["omega"]) and np.array_equal(log["delta"], plain["delta"])
    ahead = plain["x"] + 0.1 * np.cos(plain["yaw"])
    late = 0.5 * (ahead.shift(2) + ahead.shift(3))  # 2.5 samples
    assert np.abs(log["x"] - late)[3:].max() < 1e-5 and log["x"][0] == ahead[0]


def test_late_stamps_move_every_channel_on_board_alike():
    offset = ["+vehicle/effect=command_timestamp_offset", "vehicle.effects.command_timestamp_offset.latency=0.03"]
    (_, plain), (_, log) = drive(*SHORT, *QUIET), drive(*SHORT, *QUIET, *offset)
    for name in ("delta", "omega", "delta_ref", "omega_ref"):
        assert np.allclose(log[name][3:], plain[name].shift(3)[3:]), name
    assert np.array_equal(log["yaw"], plain["yaw"])


def test_a_sensor_needs_a_standard_deviation():
    with pytest.raises(RacerlError, match=r"car\.sensors\.yaw = -1"):
        Sensors(yaw=-1.0)


def test_the_log_is_a_drive_log(programme):
    _, log = programme
    checked = Log.from_table("programme", log)
    assert checked.dt == 0.01 and len(checked.table) == len(log) == 60_000 and not checked.remarks
    assert set(checked.channels) == {
        *("x", "y", "yaw", "v_x", "v_y", "yaw_rate", "delta", "omega", "delta_ref", "omega_ref")
    }


def test_velocities_agree_with_the_truth_within_noise(programme):
    """A cubic over 11 samples has a noise gain of 0.246/dt; the rest is what it smooths away."""
    recording, log = programme
    error = log[["v_x", "v_y", "yaw_rate"]].to_numpy() - recording.truth[:, 3:6]
    calm = (log["manoeuvre"] == "transit").to_numpy() & (np.hypot(*recording.truth[:, 3:5].T) > 0.5)
    noise = 0.246 / 0.01 * np.array([0.0005, 0.0005, 0.001])
    assert (error[calm].std(axis=0) < 1.5 * noise).all() and (error[calm].std(axis=0) > 0.7 * noise).all()


def test_velocities_of_a_circle():
    t = np.arange(200) * 0.01
    yaw = 1.5 * t
    x, y = 2.0 * np.sin(yaw), -2.0 * np.cos(yaw)
    v_x, v_y, yaw_rate = velocities(x, y, (yaw + np.pi) % (2 * np.pi) - np.pi, 0.01, 11, 3)
    assert np.allclose(v_x, 3.0, atol=1e-3) and np.allclose(v_y, 0.0, atol=1e-3) and np.allclose(yaw_rate, 1.5)


def test_commands_act_from_their_row_on():
    """First order: ω_{k+1} = ω_ref + (ω_k − ω_ref) exp(−dt/T), with row k's reference."""
    recording, _ = drive(*SHORT)
    omega, reference = recording.truth[:, 7], recording.command[:, 1]
    decay = np.exp(-0.01 / 0.046)
    assert np.allclose(omega[1:], reference[:-1] + (omega[:-1] - reference[:-1]) * decay, atol=1e-5)


@pytest.mark.parametrize("file", ["log.parquet", "log.csv.gz"])
def test_the_same_seed_gives_the_same_bytes(tmp_path, file):
    def content(name, *more):
        record(compose_settings("record", [*SHORT, f"file={file}", *more]), tmp_path / name)
        return (tmp_path / name / file).read_bytes()

    first = content("a")
    assert first == content("b") and first != content("c", "seed=1")
    table = pd.read_parquet(tmp_path / "a" / file) if file.endswith("parquet") else pd.read_csv(tmp_path / "a" / file)
    assert Log.from_table(file, table).seconds == pytest.approx(3.0)


def test_the_driven_car_is_written_beside_the_log(tmp_path):
    settings = compose_settings("record", [*SHORT, "hidden.spread=0.2", "hidden.seed=3"])
    facts = record(settings, tmp_path / "out")
    driven, configured = load_vehicle(read_yaml(tmp_path / "out" / VEHICLE)), load_vehicle(settings["vehicle"])
    share = {
        name: value / values(configured)[name] for name, value in values(driven).items() if values(configured)[name]
    }
    changed = {name for name, value in share.items() if value != 1.0}
    assert {"friction", "front.p_Ky1", "rear.p_Ky1", "drive.time_constant"} <= changed
    assert not {"mass", "wheelbase", "l_f", "front.F_z0"} & changed
    assert all(0.8 <= value <= 1.2 for value in share.values()) and facts["rows"] == 300


def test_hidden_cars_differ_by_seed_only():
    vehicle = load_vehicle(compose_settings("record", [])["vehicle"])
    draw = [Hidden(0.2, seed, ["friction", "*.p_Ky1"]).draw(vehicle) for seed in (1, 1, 2)]
    assert draw[0] == draw[1] != draw[2] and set(draw[0]) == {"friction", "front.p_Ky1", "rear.p_Ky1"}
    assert Hidden(0.0, 1, ["friction"]).draw(vehicle) == {}


def test_a_vehicle_file_is_resolved(tmp_path):
    settings = compose_settings("record", [])["vehicle"]
    (tmp_path / "car.yaml").write_text("mass: 3.0\n")
    document = vehicle_document({"file": tmp_path / "car.yaml", "friction": 0.5}, {"friction": 0.4}, "wheel_speed")
    assert document == {"mass": 3.0, "friction": 0.4}
    changed = vehicle_document(settings, {"drive.time_constant": 0.1}, "wheel_speed")
    assert changed["wheel_speed"]["time_constant"] == 0.1 and settings["wheel_speed"]["time_constant"] == 0.046


def test_motor_current_is_logged_in_its_own_channel():
    _, log = drive("drive=race", "seconds=3", "sim=motor_current", "step=0.001")
    assert "current" in log and "omega_ref" not in log and log["current"].abs().max() > 5.0


def test_a_log_is_never_written_over(tmp_path):
    settings = compose_settings("record", SHORT)
    record(settings, tmp_path / "out")
    with pytest.raises(RunError, match="already holds"):
        record(settings, tmp_path / "out")


def test_an_interrupted_drive_leaves_no_log(tmp_path):
    def interrupt(share: float) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        record(compose_settings("record", SHORT), tmp_path / "out", interrupt)
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"manifest.json", "config.yaml"}
    assert record(compose_settings("record", SHORT), tmp_path / "out")["rows"] == 300


@pytest.mark.parametrize(
    "words, said",
    [
        (["drive=programm"], "programme"),
        (["drive.blok=3"], "drive.block"),
        (["drive.block=1"], "allowed is a number, 5"),
        (["drive=race", "drive.share=3"], "allowed is a number, 0.05"),
        (["rate=5"], "rate = 5"),
        (["seconds=-1"], "seconds = -1"),
        (["seed=0.5"], "seed = 0.5"),
        (["floor=[12]"], "two lengths"),
        (["file=log.txt"], ".parquet"),
        (["file=../log.csv"], "a name"),
        (["smoothing.window=10"], "odd window"),
        (["hidden.spread=2"], "hidden.spread"),
        (["hidden.spread=0.1", "hidden.parameters=[frction]"], "friction"),
        (["car.sensors.positon=1"], "position"),
        (["sim=motor_current", "sim.actuators=false"], "sim.actuators=true"),
    ],
)
def test_mistakes_are_one_line(tmp_path, words, said):
    with pytest.raises(RacerlError) as error:
        record(compose_settings("record", words), tmp_path / "out")
    assert said in str(error.value) and "\n" not in str(error.value)
    assert not (tmp_path / "out").exists()
