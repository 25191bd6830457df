"""The rivals at the wheel: clean laps on the model, what they do when a solver fails, and what a user may mistype."""

import dataclasses

import numpy as np
import pytest
import torch

from racerl.assemble import Car
from racerl.config import compose_settings
from racerl.control.controllers import create_controller
from racerl.control.controllers.pure_pursuit import PurePursuit
from racerl.documents import read_yaml
from racerl.errors import ConfigError
from racerl.evaluate.drive import drive
from racerl.evaluate.laps import score
from racerl.evaluate.rivals import later, prepare
from racerl.optimum.along import XI, N
from tests.conftest import CONF

OPTIMUM = 5.155  # s, racerl optimum on the default car and track


def ready(*words):
    settings = compose_settings("race", ["seeds=[0]", *words])
    return prepare(settings, Car("model"))


def test_the_mpc_laps_cleanly_within_five_percent_of_the_optimum():
    field, pilot = ready("controller=mpc")
    result = score(drive(field, pilot, 2))
    assert (
        result["valid_laps"] == 2 and result["mean_lap_s"] < 1.05 * OPTIMUM
    )  # its numbers are for friction that is 5 % unsure
    assert pilot.facts["fallbacks"] == 0 and pilot.facts["steps"] > 200


def test_the_mpc_predicts_over_its_own_delay():
    field, pilot = ready("controller=mpc", "controller.delay=0.03")
    for _ in range(20):
        field.step(pilot.act(field))
    before = field.state[:, 0].double().clone()
    pilot.act(field)
    start = pilot.plan(0).y[0]
    # the plan begins where the car is 0.03 s later, under the commands that were on their way
    _, z = pilot._line.locate(field, field.state, field.s)
    now = z[0].double().numpy()
    assert start[1 + 2] != pytest.approx(now[2], abs=1e-4)  # v_x has moved on
    actual = field.state.clone()
    acting = torch.stack([field.history[0]] * 3)
    for k in range(3):
        actual = field.motion(actual, acting[k], field.draws.values)
    _, z = pilot._line.locate(field, actual, field.s)
    assert np.allclose(start[1 : 1 + 7], z[0, :7].double().numpy(), atol=5e-3)
    assert torch.equal(before, field.state[:, 0].double())


def test_without_a_solver_the_car_goes_on_slowly_and_it_is_counted():
    field, pilot = ready("controller=mpc")
    for _ in range(40):
        field.step(pilot.act(field))
    pilot.qp.solve = lambda problem: None
    for _ in range(60):
        step = field.step(pilot.act(field))
        assert not bool(step.terminated.any())
    assert pilot.facts["fallbacks"] == 60 and float(field.v_x[0]) < 3.2
    y = pilot.plan(0).y
    assert np.abs(y[-1, 1 + N]) < 0.3 and np.abs(y[-1, 1 + XI]) < 0.5


def test_cars_have_plans_of_their_own():
    alone, pilot = ready("controller=mpc", "seeds=[1]")
    together, pilots = ready("controller=mpc", "seeds=[0,1]")
    for _ in range(15):
        alone.step(pilot.act(alone))
        together.step(pilots.act(together))
    assert torch.allclose(alone.state[:, 0], together.state[:, 1], atol=1e-3)


@pytest.mark.slow
def test_pure_pursuit_laps_cleanly_on_the_optimum_and_on_a_line_of_ones_own(tmp_path, middle_line):
    field, pursuer = ready("controller=pure_pursuit")
    result = score(drive(field, pursuer, 2))
    assert result["valid_laps"] == 2 and result["mean_lap_s"] < 9.0
    words = ["controller=pure_pursuit", f"controller.raceline={middle_line}", "controller.speed=1.0"]
    field, pursuer = ready(*words)
    slow = score(drive(field, pursuer, 1))
    assert slow["valid_laps"] == 1 and slow["mean_lap_s"] == pytest.approx(field.track.length / 1.4, rel=0.08)
    line, rows = tmp_path / "line.csv", middle_line.read_text().splitlines()[1:]
    line.write_text("x,y\n1,2\n")
    with pytest.raises(ConfigError, match="no TUM raceline"):
        ready("controller=pure_pursuit", f"controller.raceline={line}")
    line.write_text("\n".join(rows[:4]))
    with pytest.raises(ConfigError, match="10 points"):
        ready("controller=pure_pursuit", f"controller.raceline={line}")


@pytest.mark.parametrize(
    "name", sorted(path.stem for path in (CONF / "controller").glob("*.yaml") if path.stem != "file")
)
def test_every_file_builds(name):
    settings = read_yaml(CONF / "controller" / f"{name}.yaml")
    design = create_controller(settings)
    fields = {field.name for field in dataclasses.fields(design)}
    assert fields == set(settings) - {"name"}  # every number can be set


@pytest.mark.parametrize(
    "words, said",
    [
        (["controller=mpc", "controller.nodes=3"], "controller.nodes = 3"),
        (["controller=mpc", "controller.damping=0"], "controller.damping = 0"),
        (["controller=mpc", "controller.q_drive=-1"], "controller.q_drive = -1"),
        (["controller=mpc", "sim=motor_current", "action=current"], "commands wheel speeds"),
        (["controller=pure_pursuit", "sim=motor_current", "action=current"], "commands wheel speeds"),
        (["controller=pure_pursuit", "controller.speed=9"], "controller.speed = 9"),
    ],
)
def test_mistakes_are_one_line(words, said):
    with pytest.raises(ConfigError, match=said) as error:
        ready(*words)
    assert "\n" not in str(error.value)


def test_a_file_gives_the_controller_and_the_command_line_changes_it(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text("name: pure_pursuit\nspeed: 0.5\nahead: 0.4\nahead_time: 0.1\npreview: 0.1\n")
    settings = compose_settings("race", [f"controller={path}", "+controller.speed=0.6"])
    assert create_controller(settings["controller"]) == PurePursuit(speed=0.6, ahead=0.4, ahead_time=0.1, preview=0.1)


def test_a_controllers_delay_is_added_to_the_cars_own():
    vehicle = {"mass": 5.0, "effects": {"steering_delay": {"delay": 0.02}, "aero_drag": {"c": 1.0}}}
    late = later(vehicle, 0.01)
    assert late["effects"]["steering_delay"]["delay"] == pytest.approx(0.03)
    assert late["effects"]["drive_delay"]["delay"] == pytest.approx(0.01)
    assert late["effects"]["aero_drag"] == {"c": 1.0} and vehicle["effects"]["steering_delay"] == {"delay": 0.02}
    assert later(vehicle, 0.0)["effects"] == vehicle["effects"]
