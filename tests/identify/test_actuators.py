"""Actuators are fitted from their own commands: what the car's model lacks cannot move them."""

import pytest

from racerl.data.load import load_given
from racerl.estimation.unknowns import choose_unknowns
from racerl.identify.task import make_task, own_parameters
from racerl.identify.windows import choose_wiring
from racerl.vehicle.load import load_vehicle
from racerl.vehicle.parameter import values
from racerl.vehicle.rollout import Rollout
from tests.identify.conftest import FEW, settings_for
from tests.vehicle.conftest import make_car

TRUTH = {"steering.time_constant": 0.044, "drive.time_constant": 0.046}  # s, of the published car


def test_a_missing_effect_does_not_move_them(lacking):
    parameters = lacking.facts["parameters"]
    for name, truth in TRUTH.items():
        low, high = parameters[name]["ci95"]
        assert low <= truth <= high and parameters[name]["value"] == pytest.approx(truth, rel=0.02), name
    assert lacking.facts["actuators_alone"] == list(TRUTH)
    channels = lacking.facts["verdict"]["channels"]
    assert channels["delta"]["factor"] < 1.01 and channels["omega"]["factor"] < 1.01


@pytest.mark.parametrize(
    "word, fitted",
    [("inputs=auto", list(TRUTH)), ("+weights.delta=0", ["drive.time_constant"]), ("inputs=measured", [])],
)
def test_which_are_fitted_alone(damped, word, fitted):
    settings = settings_for(damped, FEW, word)
    logs, car = load_given(settings), load_vehicle(settings["vehicle"])
    wiring = choose_wiring(logs, settings["inputs"])
    unknowns = choose_unknowns(wiring.driven(car), settings["priors"], settings["hold"], car)
    rollout = Rollout(wiring.driven(car), unknowns.names, wiring.observed, settings["step"])
    task = make_task(settings, rollout, unknowns, wiring, logs)
    assert [name for alone in task.actuators for name in alone.unknowns.names] == fitted


@pytest.mark.parametrize(
    "effect, delta, omega",
    [
        (None, ["steering.time_constant"], ["drive.time_constant"]),
        ("steering_deadband", ["steering.time_constant", "effects.steering_deadband.width"], ["drive.time_constant"]),
        ("drive_load_droop", ["steering.time_constant"], []),  # the tyres' forces, so the motion, slow the wheels
        ("yaw_damping", ["steering.time_constant"], ["drive.time_constant"]),
    ],
)
def test_what_nothing_but_the_command_moves(effect, delta, omega):
    car = make_car(*([f"+vehicle/effect={effect}"] if effect else []))
    names = [name for name in values(car) if name.endswith("time_constant") or name.startswith(("effects", "front"))]
    assert own_parameters(car, names, "delta") == delta and own_parameters(car, names, "omega") == omega
    assert own_parameters(car, names, "yaw_rate") == []
