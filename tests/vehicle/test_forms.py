"""Vehicles in other stacks' forms: the same side forces, there and back."""

import logging

import numpy as np
import pytest
import torch
import yaml
from typer.testing import CliRunner

from racerl.cli import app
from racerl.deploy.vehicle import GYM, PACEJKA, export_vehicle
from racerl.documents import read_yaml
from racerl.errors import VehicleError
from racerl.vehicle.forms import gym_form, lacking, pacejka_form
from racerl.vehicle.load import load_vehicle
from racerl.vehicle.ops import TORCH
from tests.conftest import CONF

GRAVITY = 9.81
SLIDES = np.array([-0.4, -0.1, -0.02, 0.0, 0.01, 0.05, 0.2, 0.6])  # tan α
NUC2 = """
C_Pf: [4.8, 2.16, 0.65, 0.373]
C_Pr: [20.0, 1.5, 0.618, 0.0]
I_z: 0.058
h_cg: 0.014
l_f: 0.162
l_r: 0.145
l_wb: 0.307
m: 3.54
mu: 0.9
tau_steer: 0.158
tire_model: pacejka
"""


def car(name="published", **changes):
    return load_vehicle({**read_yaml(CONF / "vehicle" / f"{name}.yaml"), **changes})


def static_loads(vehicle):
    """Loads of the axles in N of a car that stands."""
    share = vehicle.l_f / vehicle.wheelbase
    return vehicle.mass * GRAVITY * (1.0 - share), vehicle.mass * GRAVITY * share


def side(tyre, slip, load, mu):
    """The side force of an axle at tan α = slip."""
    slip = torch.tensor(float(slip), dtype=torch.float64)
    return float(tyre.forces(torch.zeros_like(slip), slip, torch.full_like(slip, float(load)), float(mu), TORCH)[1])


def pacejka(row, mu, load, slip):
    """The side force as ForzaETH's stack has it."""
    B, C, D, E = row
    return mu * D * load * np.sin(C * np.arctan(B * slip - E * (B * slip - np.arctan(B * slip))))


@pytest.mark.parametrize("name", ["published", "f1tenth", "jetracer"])
def test_side_forces_are_the_same_in_the_other_formula(name):
    vehicle = car(name)
    form = pacejka_form(vehicle, name)
    for tyre, key, load in zip((vehicle.front, vehicle.rear), ("C_Pf", "C_Pr"), static_loads(vehicle), strict=True):
        for slip in SLIDES:
            ours = side(tyre, slip, load, vehicle.friction)
            assert ours == pytest.approx(pacejka(form[key], form["mu"], load, slip), abs=1e-9)
    assert form["l_f"] + form["l_r"] == pytest.approx(form["l_wb"]) and form["m"] == vehicle.mass


def test_the_gym_has_the_stiffness_and_the_peak():
    vehicle = car(effects={"longitudinal_load_transfer": {"height": 0.07}})
    form = gym_form(vehicle)
    for tyre, key, load in zip((vehicle.front, vehicle.rear), ("C_Sf", "C_Sr"), static_loads(vehicle), strict=True):
        slope = side(tyre, 1e-6, load, 0.8) / 1e-6
        assert form["mu"] * form[key] * load == pytest.approx(slope, rel=1e-4)
    assert 0.8 * 0.6436 < form["mu"] < 0.8 * 0.7975 and form["h"] == 0.07 and form["I"] == vehicle.yaw_inertia


def test_a_vehicle_goes_out_and_comes_back(tmp_path, caplog):
    vehicle = car(effects={"longitudinal_load_transfer": {"height": 0.07}, "yaw_damping": {"coefficient": 0.1}})
    mine = tmp_path / "model.yaml"
    document = read_yaml(CONF / "vehicle" / "published.yaml")
    effects = {"longitudinal_load_transfer": {"height": 0.07}, "yaw_damping": {"coefficient": 0.1}}
    mine.write_text(yaml.safe_dump({**document, "effects": effects}))
    told = export_vehicle({"run": str(mine)}, tmp_path / "out")
    assert told["lacking"] == ["yaw_damping"]
    with caplog.at_level(logging.WARNING):
        back = load_vehicle({"file": str(tmp_path / "out" / PACEJKA)})
        load_vehicle({"file": str(tmp_path / "out" / PACEJKA)})
    assert caplog.text.count("are of vehicle=published") == 1
    assert set(back.effects) == {"longitudinal_load_transfer"}
    for name in ("mass", "yaw_inertia", "wheelbase", "l_f", "friction"):
        assert getattr(back, name) == pytest.approx(getattr(vehicle, name))
    for slip in SLIDES:
        for ours, theirs in ((vehicle.front, back.front), (vehicle.rear, back.rear)):
            both = [side(tyre, slip, 25.0, 0.8) for tyre in (ours, theirs)]
            assert both[0] == pytest.approx(both[1], rel=0.01, abs=1e-9)  # the load is not the nominal one
    gym = load_vehicle({"file": str(tmp_path / "out" / GYM)})
    again = gym_form(gym)
    assert again == pytest.approx(gym_form(vehicle)) and gym.front.p_Dy1 == 1.0
    for other in (back, gym):  # lengthways the grip stays the published car's, whatever mu is
        pulls = [float(each.rear.p_Dx1) * float(each.friction) for each in (vehicle, other)]
        assert pulls[0] == pytest.approx(pulls[1])


def test_a_file_of_the_race_stack_is_a_vehicle(tmp_path):
    file = tmp_path / "NUC2_pacejka.yaml"
    file.write_text(NUC2)
    vehicle = load_vehicle({"file": str(file), "friction": 0.7})
    assert vehicle.friction == 0.7 and vehicle.wheelbase == pytest.approx(0.307)
    assert vehicle.steering.time_constant == 0.158 and vehicle.effects["longitudinal_load_transfer"].height == 0.014
    load = static_loads(vehicle)[1]
    for slip in SLIDES:
        ours = side(vehicle.rear, slip, load, 0.9)
        assert ours == pytest.approx(pacejka([20.0, 1.5, 0.618, 0.0], 0.9, load, slip), rel=1e-6, abs=1e-9)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("mu: 0.9", "lacks mu"),
        ("C_Pf: [4.8, 2.16, 0.65, 0.373]", "four numbers B, C, D, E"),
        ("m: 3.54", "m = 'heavy': a number is expected"),
        ("C_Pr: [20.0, 1.5, 0.618, 0.0]", "p_Ey1 = 1.3"),
        ("l_r: 0.145", "l_r = 0: more than 0"),
        ("mu: 0.9", "mu = -1: more than 0"),
        ("h_cg: 0.014", "height = -0.1"),
    ],
)
def test_what_is_wrong_in_such_a_file_is_said_in_one_line(tmp_path, change, said):
    wrong = {"lacks mu": "", "four numbers B, C, D, E": "C_Pf: [4.8]", "m = 'heavy': a number is expected": "m: heavy"}
    wrong |= {"l_r = 0: more than 0": "l_r: 0", "mu = -1: more than 0": "mu: -1", "height = -0.1": "h_cg: -0.1"}
    file = tmp_path / "car.yaml"
    file.write_text(NUC2.replace(change, wrong.get(said, "C_Pr: [20.0, 1.5, 0.618, 1.3]")))
    with pytest.raises(VehicleError, match=said.replace("(", r"\(")):
        load_vehicle({"file": str(file)})


def test_what_the_other_forms_lack_is_told():
    tyre = read_yaml(CONF / "vehicle" / "published.yaml")["front"]
    assert lacking(car()) == []
    assert lacking(car(front={**tyre, "p_Hy1": 0.05})) == ["front.p_Hy1"]
    with pytest.raises(VehicleError, match="no peak at the car's own load of 26 N"):
        gym_form(car(front={**tyre, "F_z0": 60.0, "p_Dy1": 0.5, "p_Dy2": 1.0}))


def test_the_command_says_what_the_other_forms_lack(tmp_path):
    mine = tmp_path / "model.yaml"
    document = read_yaml(CONF / "vehicle" / "published.yaml")
    mine.write_text(yaml.safe_dump({**document, "effects": {"yaw_damping": {"coefficient": 0.1}}}))
    told = CliRunner().invoke(app, ["export", str(mine), f"out={tmp_path / 'out'}"])
    assert told.exit_code == 0 and "warning: neither knows yaw_damping" in told.output
    assert sorted(path.suffix for path in (tmp_path / "out").glob("[fp]*")) == [".yaml", ".yaml"]
