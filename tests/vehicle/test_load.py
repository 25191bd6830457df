"""Vehicles from settings and files: everything wrong is named in one line."""

import pytest

from racerl.documents import read_yaml, write_yaml
from racerl.errors import RacerlError
from racerl.vehicle.load import load_vehicle
from racerl.vehicle.parameter import replace_values, values
from tests.conftest import CONF


@pytest.fixture
def settings():
    return read_yaml(CONF / "vehicle" / "f1tenth.yaml")


def change(settings, path, value):
    *folders, last = path.split(".")
    for folder in folders:
        settings = settings[folder]
    if value is None:
        del settings[last]
    else:
        settings[last] = value


@pytest.mark.parametrize(
    "path, value, said",
    [
        ("mass", -3.0, ["mass", "-3", "0.1", "kg"]),
        ("mass", None, ["mass", "missing"]),
        ("mass", "heavy", ["mass", "heavy"]),
        ("mass", True, ["mass", "True"]),
        ("mas", 3.0, ["mas", "mass"]),
        ("l_f", 0.4, ["l_f", "wheelbase"]),
        ("front.p_Dy1", 99.0, ["front.p_Dy1", "99"]),
        ("front.p_Dy", 1.0, ["p_Dy", "p_Dy1"]),
        ("rear.p_Ky1", None, ["rear", "p_Ky1", "missing"]),
        ("rear", None, ["rear", "missing"]),
        ("front", 3.0, ["front", "mapping"]),
        ("steering.time_constant", 0.0, ["time_constant", "0.002"]),
        ("effects", {"aero_drug": {}}, ["aero_drug", "aero_drag"]),
        ("effects", {"aero_drag": {}}, ["coefficient", "missing"]),
        ("effects", {"__init__": {}}, ["__init__"]),
        ("effects", {"os": {}}, ["os"]),
        ("effects", ["yaw_damping"], ["vehicle.effects = ['yaw_damping']", "{yaw_damping: {coefficient: 0.15}}"]),
        ("effects", "yaw_damping", ["vehicle.effects = yaw_damping"]),
        ("file", 3.0, ["vehicle.file = 3.0", "vehicle=model.yaml"]),
    ],
)
def test_mistakes_are_named_in_one_line(settings, path, value, said):
    change(settings, path, value)
    with pytest.raises(RacerlError) as error:
        load_vehicle(settings)
    assert all(word in str(error.value) for word in said) and "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("path", "value", "said"), [("rear", None, "'rear' is missing"), ("effects", {"aero_drug": {}}, "aero_drag")]
)
def test_a_mistake_in_a_file_is_told_with_its_name(settings, path, value, said, tmp_path):
    change(settings, path, value)
    write_yaml(tmp_path / "model.yaml", settings)
    with pytest.raises(RacerlError, match=rf"{said}.* \(with vehicle=.*model\.yaml\)$"):
        load_vehicle({"file": str(tmp_path / "model.yaml")})


def test_unknown_drive_mode(settings):
    with pytest.raises(RacerlError, match="wheel_speed"):
        load_vehicle(settings, drive="wheel_sped")


def test_a_model_file_is_a_vehicle(settings, tmp_path):
    settings["mass"] = 4.2
    write_yaml(tmp_path / "model.yaml", settings)
    assert load_vehicle({"file": str(tmp_path / "model.yaml")}).mass == 4.2


def test_values_and_replace_are_inverse(settings):
    car = load_vehicle({**settings, "effects": {"aero_drag": {"coefficient": 0.2}}})
    doubled = {name: value * 2 for name, value in values(car).items()}
    assert values(replace_values(car, doubled)) == doubled
    assert "effects.aero_drag.coefficient" in doubled and "front.p_Dy1" in doubled
