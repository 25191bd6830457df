"""A recorded bag: its topics are the stock system's, and read back it is the same log."""

import numpy as np

from racerl.config import compose_settings
from racerl.data.load import load_logs
from racerl.record.bag import encode_bag
from racerl.record.record import record
from tests.record.conftest import drive


def test_the_reader_finds_the_log_that_was_recorded(tmp_path):
    _, log = drive("seconds=60")
    assert log["run"].nunique() == 2
    content = encode_bag(log, 0.33)
    assert content == encode_bag(log, 0.33)
    (tmp_path / "log.mcap").write_bytes(content)
    back = load_logs([tmp_path / "log.mcap"], compose_settings("data", ["logs=[x]", "data=f1tenth"])["data"])[0]
    assert back.table["run"].nunique() == 2 and len(back.table) == len(log)
    assert set(back.channels) == {"x", "y", "yaw", "v_x", "v_y", "yaw_rate", "omega", "delta_ref", "omega_ref"}
    assert not back.reckoned
    for channel in back.channels:
        error = back.array(channel) - log[channel].to_numpy()
        if channel == "yaw":
            error -= 2 * np.pi * np.round(error / (2 * np.pi))
        assert np.abs(error).max() < 1e-6, channel


def test_record_writes_a_bag_where_the_name_says_so(tmp_path):
    record(compose_settings("record", ["drive=race", "seconds=2", "file=log.mcap"]), tmp_path / "run")
    assert {path.name for path in (tmp_path / "run").iterdir()} >= {"log.mcap", "vehicle.yaml", "manifest.json"}
    assert (tmp_path / "run" / "log.mcap").read_bytes()[:5] == b"\x89MCAP"


def test_a_car_that_takes_currents_records_no_speed_that_was_asked_for(tmp_path):
    _, log = drive("drive=race", "seconds=3", "sim=motor_current")
    (tmp_path / "log.mcap").write_bytes(encode_bag(log, 0.33))
    back = load_logs([tmp_path / "log.mcap"], compose_settings("data", ["logs=[x]"])["data"])[0]
    assert "omega_ref" not in back.channels
    np.testing.assert_allclose(back.array("current"), log["current"], atol=1e-9)
