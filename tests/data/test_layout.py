"""Mappings: every file in conf/data is valid, and a mistake in one is a line with the near names."""

import numpy as np
import pytest

from racerl.config import compose_settings
from racerl.data.layout import Source, read_layout
from racerl.errors import ConfigError
from tests.conftest import CONF
from tests.data.conftest import mapping

MAPPINGS = sorted(path.stem for path in (CONF / "data").glob("*.yaml"))


@pytest.mark.parametrize("name", MAPPINGS)
def test_every_mapping_composes(name):
    settings = compose_settings("data", ["logs=[x]", f"data={name}"])
    layout = read_layout(settings["data"])
    assert layout == read_layout(mapping(name)) and 0.1 < layout.vehicle.wheelbase < 1.0


def test_keys_can_be_set():
    settings = compose_settings("data", ["logs=[x]", "data=put", "data.shift.delta_ref=0.05", "data.savgol.window=15"])
    layout = read_layout(settings["data"])
    assert layout.shift["delta_ref"] == 0.05 and layout.savgol.window == 15


def test_a_name_alone_is_a_topic_or_a_column():
    layout = read_layout({"channels": {"x": ["/pose", {"topic": "/odom"}], "delta_ref": "/drive"}})
    assert layout.channels["x"] == (Source(topic="/pose"), Source(topic="/odom"))
    assert layout.channels["delta_ref"] == (Source(topic="/drive", hold=True),) and layout.of_bag
    assert read_layout({"channels": {"x": "x [m]"}}).channels["x"] == (Source(column="x [m]"),)


def test_points_make_straight_lines_held_outside():
    source = Source(column="s", points=((-1.0, -0.4), (0.0, 0.0), (1.0, 0.3)))
    values = source.convert(np.array([-2.0, -0.5, 0.5, 3.0, np.nan]))
    np.testing.assert_allclose(values[:4], [-0.4, -0.2, 0.15, 0.3])
    assert np.isnan(values[4])


@pytest.mark.parametrize(
    "change, said",
    [
        ({"savgoal": {}}, "did you mean savgol"),
        ({"channels": {"omgea": {"column": "a"}}}, "did you mean omega"),
        ({"channels": {"omega": {"colum": "a"}}}, "did you mean column"),
        ({"channels": {"omega": {}}}, "give a column"),
        ({"channels": {"omega": {"column": "a", "topic": "/b"}}}, "one of them"),
        ({"channels": {"omega": {"column": "a"}, "x": {"topic": "/b"}}}, "a bag or a table"),
        ({"channels": {"omega": {"column": "a", "scale": 0}}}, "wipe"),
        ({"channels": {"omega": {"column": "a", "scale": "fast"}}}, "allowed is a number"),
        ({"channels": {"omega": {"column": "a", "points": [[1, 2], [1, 3]]}}}, "increasing"),
        ({"channels": {"omega": {"column": "a", "points": [1, 2]}}}, "pairs"),
        ({"channels": 3}, "mapping is expected"),
        ({"time": {"colunm": "t"}}, "did you mean column"),
        ({"time": {"stamp": "recieved"}}, "did you mean received"),
        ({"shift": {"detla": 0.1}}, "did you mean delta"),
        ({"shift": {"delta": "late"}}, "allowed is a number"),
        ({"savgol": {"window": 10, "order": 3}}, "odd"),
        ({"savgol": {"window": 3, "order": 3}}, "above the order"),
        ({"resample": -1}, "2 …"),
        ({"gap": 0}, "data.gap"),
        ({"frame": {"forward": 99}}, "-10 … 10 m"),
        ({"velocities": "given by hand"}, "auto, columns, poses"),
        ({"vehicle": {"wheelbase": True}}, "allowed is a number"),
    ],
)
def test_mistakes_are_one_line_with_the_near_names(change, said):
    with pytest.raises(ConfigError, match=said) as error:
        read_layout({**mapping("drive_log"), **change})
    assert "\n" not in str(error.value)
