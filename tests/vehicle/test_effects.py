"""What each effect does to the car, in numbers; and what the catalogue says of it."""

import dataclasses
import math
import re

import pytest
import torch

from racerl.config import compose_settings
from racerl.errors import ConfigError, VehicleError
from racerl.vehicle import catalogue
from racerl.vehicle.effects import Effect
from racerl.vehicle.effects.double_track import DoubleTrack
from racerl.vehicle.effects.learned_network import LearnedNetwork
from racerl.vehicle.effects.learned_residual import LearnedResidual
from racerl.vehicle.effects.tyre_shape import TyreShape
from racerl.vehicle.load import load_vehicle
from racerl.vehicle.ops import TORCH
from racerl.vehicle.vehicle import COMMAND, STATE, Slips, Vehicle
from tests.vehicle.conftest import EFFECTS, make_car, random_states, travel

CONTRACT = (
    "steering_delay",
    "steering_second_order",
    "steering_rate_limit",
    "steering_backlash",
    "steering_deadband",
    "steering_offset",
    "steering_gain_asymmetry",
    "steering_nonlinearity",
    "steering_gain",
    "steering_saturation",
    "steering_compliance",
    "drive_delay",
    "drive_brake_asymmetry",
    "current_limit",
    "drive_saturation",
    "back_emf",
    "battery_sag",
    "drive_load_droop",
    "regen_braking",
    "drive_split",
    "locked_differential",
    "rolling_resistance",
    "viscous_drag",
    "aero_drag",
    "downforce",
    "longitudinal_load_transfer",
    "lateral_load_sensitivity",
    "tyre_relaxation",
    "friction_fade",
    "tyre_heating",
    "speed_dependent_friction",
    "friction_patch",
    "camber_thrust",
    "yaw_damping",
    "roll_dynamics",
    "cog_longitudinal_offset",
    "cog_lateral_offset",
    "road_slope",
    "road_bank",
    "pose_latency",
    "steering_sensor_latency",
    "wheel_speed_latency",
    "steering_sensor_offset",
    "wheel_speed_gain",
    "wheel_growth",
    "lever_arm",
    "mocap_yaw_misalignment",
    "command_timestamp_offset",
)
ROW = {name: i for i, name in enumerate(STATE)}


def with_effect(name: str, **parameters: float) -> Vehicle:
    changes = [f"vehicle.effects.{name}.{key}={value}" for key, value in parameters.items()]
    return make_car(f"+vehicle/effect={name}", *changes)


def states(car: Vehicle, **values: float) -> torch.Tensor:
    """Return one state with everything at 0 but what is given."""
    state = torch.zeros(len(car.states), 1, dtype=torch.float64)
    for name, value in values.items():
        state[car.states.index(name.replace("__", "."))] = value
    return state


def change(name: str, command=(0.0, 3.0), parameters=None, **values: float) -> dict[str, float]:
    """Return how the derivative of a state changes by an effect."""
    plain, car = make_car(), with_effect(name, **(parameters or {}))
    u = torch.tensor(command, dtype=torch.float64)[:, None]
    body = {key: value for key, value in values.items() if "__" not in key}
    base = plain.derivative(states(plain, **body), u, TORCH)
    got = car.derivative(states(car, **values), u, TORCH)
    return {key: float(got[i] - base[i]) for key, i in ROW.items()}


def test_the_catalogue_is_complete():
    assert set(catalogue.names()) == set(CONTRACT)


@pytest.mark.parametrize("name", CONTRACT)
def test_every_effect_explains_itself(name):
    entry = catalogue.entry(name)
    assert tuple(entry.aspects) == catalogue.ASPECTS and all(entry.aspects.values()), entry.aspects
    assert entry.title.endswith(".") and entry.parameters
    for word in re.findall(r"[a-z]+(?:_[a-z]+)+", entry.aspects["Confused with"]):
        assert word in CONTRACT or word in ("a_y", "a_x", "v_x"), word
    assert name not in entry.aspects["Confused with"].split()


def test_an_unknown_effect_is_named_with_its_neighbours():
    with pytest.raises(ConfigError, match="did you mean steering_delay"):
        catalogue.entry("steering_dely")


ROLLING = {"v_x": 3.0, "omega": 3.0}


@pytest.mark.parametrize(
    ("name", "parameters", "state", "command", "row", "expected"),
    [
        ("steering_offset", {"offset": 0.01}, ROLLING, (0.0, 3.0), "delta", 0.0),
        ("steering_rate_limit", {"limit": 1.0}, {**ROLLING, "delta": 0.0}, (0.5, 3.0), "delta", 1.0 - 0.5 / 0.044),
        ("current_limit", {"limit": 2.0}, {"v_x": 1.0, "omega": 1.0}, (0.0, 5.0), "omega", None),
        ("drive_brake_asymmetry", {"ratio": 2.0}, ROLLING, (0.0, 2.0), "omega", None),
        ("regen_braking", {"rate": 2.0, "reach": 0.2}, ROLLING, (0.0, 1.0), "omega", -6.0),
        ("regen_braking", {"rate": 2.0, "reach": 0.2}, ROLLING, (0.0, 2.98), "omega", -0.598008),  # no less of a little
        ("regen_braking", {"rate": 2.0, "reach": 0.2}, ROLLING, (0.0, 5.0), "omega", 0.0),
        ("rolling_resistance", {"force": 1.0}, ROLLING, (0.0, 3.0), "v_x", -1.0 / 5.1),
        ("viscous_drag", {"coefficient": 0.5}, ROLLING, (0.0, 3.0), "v_x", -1.5 / 5.1),
        ("aero_drag", {"coefficient": 0.05}, ROLLING, (0.0, 3.0), "v_x", -0.45 / 5.1),
        ("camber_thrust", {"share": 0.01}, ROLLING, (0.0, 3.0), "v_y", 0.0981),
        ("camber_thrust", {"share": 0.01}, ROLLING, (0.0, 3.0), "yaw_rate", 0.0),
        ("road_slope", {"x": 0.02}, {**ROLLING, "yaw": math.pi / 2}, (0.0, 3.0), "v_y", -0.1962),
        ("road_slope", {"x": 0.02}, {**ROLLING, "yaw": math.pi}, (0.0, 3.0), "v_x", -0.1962),
        ("road_bank", {"bank": 0.03, "y": 0.0}, {**ROLLING, "x": 10.0, "yaw": math.pi / 2}, (0.0, 3.0), "v_y", 0.29284),
    ],
)
def test_effects_in_numbers(name, parameters, state, command, row, expected):
    car = make_car("vehicle=published")
    assert (float(car.steering.time_constant), float(car.mass)) == (0.044, 5.1)
    plain = make_car()
    if expected is None:
        rate = (command[1] - state["omega"]) / float(plain.drive.time_constant)
        limit = {"current_limit": 2.0, "drive_brake_asymmetry": rate / 2.0}[name]
        expected = limit - rate
    elif row == "delta" and expected:
        expected = 1.0 - 0.5 / float(plain.steering.time_constant)
    elif row == "v_x" and "slope" not in name:
        expected *= 5.1 / float(plain.mass)
    assert change(name, command, parameters, **state)[row] == pytest.approx(expected, rel=2e-3, abs=1e-9)


@pytest.mark.parametrize("other", ["steering_gain", "steering_offset", "steering_gain_asymmetry"])
@pytest.mark.parametrize("order", [1, -1])
def test_play_lies_between_servo_and_linkage(other, order):
    car = make_car(f"+vehicle/effect=[steering_backlash,{other}]", "vehicle.effects.steering_backlash.play=0.04")
    car = dataclasses.replace(car, effects=dict(list(car.effects.items())[::order]))
    wheel = car.states.index("steering_backlash.wheel")
    for left, rate in ((0.1, 0.0), (0.09, 0.0), (0.05, 150.0 * 0.03), (0.16, -150.0 * 0.04)):  # servo at 0.1 ± 0.02 rad
        state = states(car, v_x=3.0, omega=3.0, delta=0.1)
        state[wheel] = left
        got = car.derivative(state, torch.tensor([[0.1], [3.0]], dtype=torch.float64), TORCH)
        assert float(got[wheel]) == pytest.approx(rate, abs=1e-9)


def turn_rate(car: Vehicle, delta: float = 0.1, speed: float = 1.5) -> float:
    """Return the steady yaw rate in rad/s."""
    state = states(car, v_x=speed, omega=speed, delta=delta)
    command = torch.tensor([[delta], [speed]], dtype=torch.float64)
    return float(travel(car, state, command, 0.005, 600)[-1, ROW["yaw_rate"]])


@pytest.mark.parametrize(
    ("name", "parameters", "sign"),
    [
        ("steering_gain", {"gain": 1.1}, 1),
        ("steering_offset", {"offset": 0.02}, 1),
        ("steering_gain_asymmetry", {"asymmetry": 0.1}, 1),
        ("steering_nonlinearity", {"cubic": 5.0}, 1),
        ("steering_saturation", {"limit": 0.05}, -1),
        ("steering_backlash", {"play": 0.04}, -1),
        ("steering_compliance", {"compliance": 0.004}, -1),
        ("locked_differential", {"track_width": 0.2}, -1),
        ("yaw_damping", {"coefficient": 0.2}, -1),
        ("cog_longitudinal_offset", {"offset": 0.03}, -1),  # ahead: understeer
    ],
)
def test_steady_turns_change_as_they_should(name, parameters, sign):
    plain, got = turn_rate(make_car()), turn_rate(with_effect(name, **parameters))
    assert abs(got / plain - 1.0) > 0.01
    assert (got > plain) == (sign > 0)


def test_grip_is_lost_where_when_and_how_it_should():
    def grip(name, parameters=None, **values):
        car = with_effect(name, **(parameters or {}))
        motion = car.motion(states(car, **values))
        state = states(car, **values)
        own = {key: state[i] for i, key in enumerate(car.states) if "." in key}
        front, rear = car.effects[name].grip((1.0, 1.0), motion._replace(own=own), TORCH)
        assert float(front) == float(rear)
        return float(front)

    for time, age in ((1e5, 100.0), (100.0, 100.0 * (1.0 - math.exp(-1.0))), (10.0, 10.0)):  # levels off
        fade = {"rate": 1e-3, "time": time}
        assert grip("friction_fade", fade, friction_fade__clock=100.0) == pytest.approx(1.0 - 1e-3 * age, abs=1e-4)
    assert grip("speed_dependent_friction", {"loss": 0.05}, v_x=4.0) == pytest.approx(0.8)
    patch = {"depth": 0.4, "x": 1.0, "radius": 2.0, "edge": 0.2}
    assert [grip("friction_patch", patch, x=x) for x in (1.0, 3.0, 6.0)] == pytest.approx([0.6, 0.8, 1.0], abs=1e-3)
    assert grip("tyre_heating", {"loss": 0.1}, tyre_heating__heat=2.0) == pytest.approx(0.8)
    turning = {"v_x": 2.5, "yaw_rate": -2.0}
    assert grip("lateral_load_sensitivity", {"loss": 0.02}, **turning) == pytest.approx(0.9, abs=5e-3)
    assert grip("roll_dynamics", {"loss": 0.02}, roll_dynamics__roll=5.0) == pytest.approx(0.9, abs=5e-3)


def force(car, name, **values):
    """Return what an effect changes in force and moment on the body."""
    motion = car.motion(states(car, **values))
    forces = car.tyre_forces(car.slips(motion, TORCH), motion, TORCH)
    before = car.tyre_wrench(forces, motion, TORCH)
    after = car.effects[name].wrench(before, forces, motion, TORCH)
    return [float(b - a) for a, b in zip(before, after, strict=True)]


@pytest.mark.parametrize("name", [name for name in EFFECTS if catalogue.entry(name).cls.grip is not Effect.grip])
def test_a_spin_leaves_grip(name):
    car = with_effect(name)
    spin = car.motion(states(car, v_x=3.0, yaw_rate=20.0))  # 60 m/s² of v_x r, which roll and heat may be, too
    spin = spin._replace(own=dict.fromkeys(spin.own, torch.tensor(60.0)))
    assert all(0.0 < float(left) <= car.friction for left in car.grip(spin, TORCH))


def test_all_of_the_rolling_resistance_acts_wherever_the_centre_of_gravity_is():
    moved = "+vehicle/effect=[rolling_resistance,cog_longitudinal_offset]"
    offset = "vehicle.effects.cog_longitudinal_offset.offset=0.05"
    car = make_car(moved, "vehicle.effects.rolling_resistance.force=1.0", offset)
    assert force(car, "rolling_resistance", v_x=3.0, omega=3.0)[0] == pytest.approx(-1.0)


def test_a_locked_differential_has_the_grip_that_the_tyres_have():
    state = {"v_x": 2.0, "yaw_rate": 2.0, "omega": 2.0}
    patch = (f"vehicle.effects.friction_patch.{word}" for word in ("depth=0.8", "radius=3.0", "edge=0.1"))
    patched = make_car("+vehicle/effect=[locked_differential,friction_patch]", *patch)
    slippery = make_car("+vehicle/effect=locked_differential", f"vehicle.friction={0.2 * float(make_car().friction)}")
    dry = make_car("+vehicle/effect=locked_differential")
    on_patch, all_over, without = (force(car, "locked_differential", **state)[2] for car in (patched, slippery, dry))
    assert on_patch == pytest.approx(all_over, rel=1e-3) and abs(on_patch) < 0.5 * abs(without)


def test_loads_shift_and_grow():
    wings = with_effect("downforce", coefficient=0.1)
    front, rear = wings.loads(wings.motion(states(wings, v_x=3.0)), TORCH)
    assert float(front + rear) == pytest.approx(float(wings.mass) * 9.81 + 0.9)
    car = with_effect("longitudinal_load_transfer", height=0.06)
    still = car.motion(states(car))
    braking = still._replace(own={"longitudinal_load_transfer.acceleration": torch.tensor([-5.0])})
    more = float(car.loads(braking, TORCH)[0] - car.loads(still, TORCH)[0])
    assert more == pytest.approx(float(car.mass) * 5.0 * 0.06 / float(car.wheelbase))


def test_the_pitch_follows_the_acceleration_of_the_car():
    car = with_effect("longitudinal_load_transfer", height=0.06)
    state = states(car, v_x=2.0, omega=2.4)
    command = torch.tensor([[0.0], [2.4]], dtype=torch.float64)
    moved = travel(car, state, command, 0.001, 40)[-1]
    rate = car.derivative(moved, command, TORCH)
    assert float(moved[8]) == pytest.approx(float(rate[ROW["v_x"]]), rel=0.2) and float(moved[8]) > 0.5


def test_play_has_two_sides():
    """Coming from the left or from the right, the wheels rest on different sides of the gap."""
    car = with_effect("steering_backlash", play=0.04)
    effect, index = car.effects["steering_backlash"], car.states.index("steering_backlash.wheel")

    def turned_back(side: float) -> torch.Tensor:
        state = states(car, v_x=1.0, omega=1.0)
        for angle in (side, 0.0):
            state = travel(car, state, torch.tensor([[angle], [1.0]], dtype=torch.float64), 0.002, 500)[-1]
        return state

    for state, angle in ((turned_back(0.2), 0.02), (turned_back(-0.2), -0.02)):
        own = {"steering_backlash.wheel": state[index]}
        assert float(effect.link(state[ROW["delta"]], own, TORCH)) == pytest.approx(angle, abs=1e-3)


def test_a_second_order_servo_overshoots():
    car = with_effect("steering_second_order", frequency=30.0, damping=0.4)
    state, command = states(car, v_x=1.0, omega=1.0), torch.tensor([[0.2], [1.0]], dtype=torch.float64)
    peak = float(travel(car, state, command, 0.002, 120)[:, ROW["delta"]].max())
    assert peak == pytest.approx(0.2 * (1 + math.exp(-math.pi * 0.4 / math.sqrt(1 - 0.16))), rel=0.01)


def test_a_deadband_leaves_the_servo_short_of_its_command():
    car = with_effect("steering_deadband", width=0.02)
    state, command = states(car, v_x=1.0, omega=1.0), torch.tensor([[0.2], [1.0]], dtype=torch.float64)
    short = 0.2 - float(travel(car, state, command, 0.002, 500)[-1, ROW["delta"]])
    assert 0.01 < short < 0.03


def test_relaxation_takes_a_distance():
    car = with_effect("tyre_relaxation", length=0.3)
    start = states(car, v_x=3.0, v_y=0.3, omega=3.0)
    rates = car.derivative(start, torch.tensor([[0.0], [3.0]], dtype=torch.float64), TORCH)[8:]
    slips = make_car().slips(make_car().motion(start), TORCH)
    expected = torch.stack([slips.alpha_f, slips.alpha_r]) / (0.3 / 3.1 + 0.003)
    assert torch.allclose(rates, expected)


def test_torque_falls_with_speed():
    slow = change("back_emf", (0.0, 9.0), {"stall": 20.0, "top_speed": 8.0}, v_x=1.0, omega=1.0)["omega"]
    fast = change("back_emf", (0.0, 9.0), {"stall": 20.0, "top_speed": 8.0}, v_x=4.0, omega=4.0)["omega"]
    constant = float(make_car().drive.time_constant)
    assert slow + 8.0 / constant == pytest.approx(17.5, abs=0.1)
    assert fast + 5.0 / constant == pytest.approx(10.0, abs=0.1)


def test_wheels_stop_at_their_largest_speed():
    constant = float(make_car().drive.time_constant)
    for asked, reached in ((5.0, 1.3), (0.6, 0.6), (-5.0, -1.3)):  # either way round; slow commands are left alone
        rate = change("drive_saturation", (0.0, asked), {"limit": 1.3}, v_x=1.0, omega=1.0)["omega"]
        assert rate * constant == pytest.approx(reached - asked, abs=0.002)
    words = ["vehicle=published", "+vehicle/effect=drive_saturation"]
    with pytest.raises(VehicleError, match="drive_saturation limits a commanded speed; with sim=motor_current"):
        load_vehicle(compose_settings("train", words)["vehicle"], "motor_current")


def test_sag_droop_and_split():
    for time, age in ((1e5, 100.0), (100.0, 100.0 * (1.0 - math.exp(-1.0)))):
        sag = {"rate": 1e-3, "time": time}
        aged = change("battery_sag", (0.0, 3.0), sag, v_x=3.0, omega=3.0, battery_sag__clock=100.0)
        assert aged["omega"] == pytest.approx(-3e-3 * age / float(make_car().drive.time_constant), rel=1e-3)
    pushing = {"v_x": 2.0, "omega": 2.3}
    assert change("drive_load_droop", (0.0, 3.0), {"droop": 0.2}, **pushing)["omega"] < -1.0
    turning = {**pushing, "delta": 0.2, "v_y": 0.1, "yaw_rate": 1.0}
    command = torch.tensor([0.0, 3.0], dtype=torch.float64)[:, None]
    apart = [
        float(car.derivative(states(car, **turning), command, TORCH)[-1])
        for car in (with_effect("drive_split", front=q) for q in (1.0, 0.0))
    ]
    assert apart[0] > 0.5 and apart[1] < -0.5  # the axle that should carry all of it runs ahead
    # softer rear tyres: the stiff ones of the default car gain more side force as their slip falls
    soft = make_car("vehicle=published", "+vehicle/effect=drive_split", "vehicle.effects.drive_split.front=0.5")
    rates = [
        float(soft.derivative(states(soft, **turning, drive_split__apart=apart), command, TORCH)[ROW["yaw_rate"]])
        for apart in (0.0, 0.3)
    ]
    assert rates[1] > rates[0] + 0.1  # the front axle pulls the nose in
    lateral = change("cog_lateral_offset", (0.0, 3.0), {"offset": 0.01}, **pushing)
    assert lateral["yaw_rate"] < 0.0


def test_sensors_show_what_they_should():
    def shown(name, parameters, **values):
        car = with_effect(name, **parameters)
        true = {key: float(values.get(key, 0.0)) for key in STATE}
        return car.measured(true, TORCH), true

    got, _ = shown("lever_arm", {"forward": 0.1, "left": 0.05}, yaw=math.pi / 2, v_x=2.0, yaw_rate=1.0)
    assert [got[key] for key in ("x", "y", "v_x", "v_y")] == pytest.approx([-0.05, 0.1, 1.95, 0.1])
    got, _ = shown("mocap_yaw_misalignment", {"angle": 0.1}, v_x=2.0)
    assert got["yaw"] == pytest.approx(0.1) and got["v_y"] == pytest.approx(-2.0 * math.sin(0.1))
    got, _ = shown("steering_sensor_offset", {"offset": 0.02}, delta=0.1)
    assert got["delta"] == pytest.approx(0.12)
    got, _ = shown("wheel_speed_gain", {"gain": 1.03}, omega=2.0)
    assert got["omega"] == pytest.approx(2.06)
    got, true = shown("wheel_growth", {"coefficient": 0.002}, omega=5.0)
    assert got["omega"] == pytest.approx(4.75) and true["omega"] == 5.0


def test_delays_and_latencies_name_their_channels():
    for name in catalogue.names():
        assert set(with_effect(name).delays()) <= set(COMMAND)
    assert with_effect("steering_delay", delay=0.04).delays() == {"delta_ref": 0.04}
    assert with_effect("drive_delay", delay=0.03).delays() == {"drive_ref": 0.03}
    assert set(with_effect("pose_latency").latencies()) == {"x", "y", "yaw", "v_x", "v_y", "yaw_rate"}
    both = make_car("+vehicle/effect=[steering_sensor_latency,command_timestamp_offset]").latencies()
    assert both == {"delta_ref": 0.02, "omega_ref": 0.02, "delta": 0.04, "omega": 0.02}


SCALED = {  # effects that vanish with a parameter
    "steering_backlash": {"play": 0.0},
    "steering_compliance": {"compliance": 0.0},
    "tyre_heating": {"loss": 0.0},
    "locked_differential": {"track_width": 0.0},
    "friction_patch": {"depth": 0.0},
    "steering_nonlinearity": {"cubic": 0.0},
    "drive_brake_asymmetry": {"ratio": 1.0},
    "lateral_load_sensitivity": {"loss": 0.0},
    "longitudinal_load_transfer": {"height": 0.0},
}


@pytest.mark.parametrize("name", SCALED)
def test_an_effect_of_no_size_changes_nothing(name):
    car, plain = with_effect(name, **SCALED[name]), make_car()
    state, command = random_states(car, 100)
    if name == "steering_backlash":
        state[8] = state[6]
    got, base = car.derivative(state, command, TORCH)[:8], plain.derivative(state[:8], command, TORCH)
    assert torch.allclose(got, base, rtol=1e-9, atol=1e-12)


WILD = {
    LearnedResidual: ({"about_turn": 30.0, "ahead_one": 30.0, "servo_lead": 30.0, "drive_speed": -30.0}, 8),
    LearnedNetwork: ({"ahead_0": 30.0, "about_1": 30.0, "about_2": -30.0}, 6),
}


@pytest.mark.parametrize("learned", WILD)
def test_what_is_learned_is_bounded_fades_where_nothing_was_seen_and_has_no_place_in_the_catalogue(learned):
    assert not {"learned_residual", "learned_network"} & set(catalogue.names())
    weights, rows = WILD[learned]
    name_of = learned.__module__.rpartition(".")[2]
    known, wild = learned(), learned(**weights)
    plain = make_car("vehicle=published")
    state, command = random_states(plain, 200)
    base = plain.derivative(state, command, TORCH)
    none = dataclasses.replace(plain, effects={name_of: known}).derivative(state, command, TORCH)
    assert torch.equal(none, base)
    most = dataclasses.replace(plain, effects={name_of: wild}).derivative(state, command, TORCH) - base
    limits = {"v_x": 3.0, "yaw_rate": 30.0, "delta": 3.0, "omega": 20.0}
    for name, limit in limits.items():
        if ROW[name] >= rows:  # a network of forces leaves the actuators alone
            assert torch.equal(most[ROW[name]], torch.zeros_like(most[0]))
            continue
        assert 0.5 * limit < float(most[ROW[name]].abs().max()) <= limit * (1.0 + 1e-9)
    beyond = dataclasses.replace(wild, speed=0.1, steering=0.01, yaw_rate=0.1)
    away = state[3].abs() > 0.5
    faded = dataclasses.replace(plain, effects={name_of: beyond}).derivative(state, command, TORCH) - base
    assert float(faded[:, away].abs().max()) < 1e-3


LARGE = {"kappa_f": 0.05, "alpha_f": 0.1, "kappa_r": 0.02, "alpha_r": 0.2}
SHAPE = TyreShape(**LARGE, ahead_turn=0.2, ahead_drive=0.1, aside_drive=-0.3, aside_turn=0.4)


def test_a_tyres_shape_multiplies_forces_by_its_factors():
    plain, car = (make_car("vehicle=published"), make_car("vehicle=published"))
    car = dataclasses.replace(car, effects={"tyre_shape": SHAPE})
    kappa, alpha = torch.tensor([0.05, 0.0, 0.0]), torch.tensor([0.0, 0.1, -10.0])
    motion = plain.motion(torch.zeros(8, 3))
    before, after = (each.tyre_forces(Slips(kappa, alpha, kappa, alpha), motion, TORCH) for each in (plain, car))
    p = 1 / math.sqrt(2)
    assert after.F_xf[0] / before.F_xf[0] == pytest.approx(1 + 0.5 * math.tanh(0.1 * p / 0.5))
    for ratio, large in ((after.F_yf / before.F_yf, 0.1), (after.F_yr / before.F_yr, 0.2)):  # of each axle's own slips
        q = (alpha[1:] / large) ** 2 / (1 + (alpha[1:] / large) ** 2)
        assert torch.allclose(ratio[1:], 1 + 0.5 * torch.tanh(0.4 * q / 0.5), rtol=1e-6)
    assert (after.F_zf, after.F_zr) == (before.F_zf, before.F_zr)


def test_a_tyres_shape_takes_slips_over_another_speed():
    plain, surface = (make_car("vehicle=published"), make_car("vehicle=published"))
    surface = dataclasses.replace(surface, effects={"tyre_shape": TyreShape(slip_drive=1.0)})
    state, command = random_states(plain, 400)
    motion = plain.motion(state)
    slips = plain.slips(motion, TORCH)
    over = surface.effects["tyre_shape"].slip(slips, motion, TORCH)
    for kappa, alpha, its_kappa, its_alpha in ((*slips[:2], *over[:2]), (*slips[2:], *over[2:])):
        near = kappa.abs() < 0.3  # there it is slip over the wheel's own speed, κ/(1 + κ)
        assert near.any() and torch.allclose(its_kappa[near], kappa[near] / (1.0 + kappa[near]), rtol=0.01)
        assert torch.allclose(its_alpha[near], alpha[near] / (1.0 + kappa[near]), rtol=0.01)
        share = its_kappa / kappa  # between these however a wheel turns
        assert float(share.max()) < math.exp(2.0) and float(share.min()) > math.exp(-math.sqrt(2.0))
    moved = surface.derivative(state, command, TORCH) - plain.derivative(state, command, TORCH)
    assert float(moved.abs().max()) > 1e-3


def test_a_tyres_shape_is_no_effect_of_the_catalogue_and_none_of_any_side():
    assert "tyre_shape" not in catalogue.names()
    car = dataclasses.replace(make_car("vehicle=published"), effects={"tyre_shape": SHAPE})
    state, command = random_states(car, 200)
    sides = torch.tensor([1.0, -1.0, -1.0, 1.0, -1.0, -1.0, -1.0, 1.0])[:, None]
    mirrored = car.derivative(sides * state, torch.tensor([[-1.0], [1.0]]) * command, TORCH)
    assert torch.allclose(mirrored, sides * car.derivative(state, command, TORCH), atol=1e-9)


def wheel_by_wheel(car: Vehicle, state: torch.Tensor, width: float, ackermann: float) -> list[float]:
    """Return F_x, F_y and M_z of four wheels by their places and speeds; what ω is ahead is an axle's."""
    *_, v_x, v_y, r, delta, omega = state[:, 0].tolist()
    weight = float(car.mass) * 9.81 / float(car.wheelbase)
    total = [0.0, 0.0, 0.0]
    for tyre, X, load, steered in (
        (car.front, float(car.l_f), weight * float(car.l_r), True),
        (car.rear, -float(car.l_r), weight * float(car.l_f), False),
    ):
        angle = delta if steered else 0.0
        push = omega - (v_x * math.cos(angle) + (v_y + r * X) * math.sin(angle))
        for Y in (0.5 * width, -0.5 * width):
            ahead, aside = v_x - r * Y, v_y + r * X
            if steered:  # cot δ_left = cot δ − Y/L
                angle = math.atan(1.0 / (1.0 / math.tan(delta) - ackermann * Y / float(car.wheelbase)))
            rolling = ahead * math.cos(angle) + aside * math.sin(angle)
            across = aside * math.cos(angle) - ahead * math.sin(angle)
            F_x, F_y = (
                0.5 * float(f) for f in tyre.forces(push / rolling, -across / rolling, load, car.friction, TORCH)
            )
            along, left = (
                F_x * math.cos(angle) - F_y * math.sin(angle),
                F_x * math.sin(angle) + F_y * math.cos(angle),
            )
            for i, part in enumerate((along, left, X * left - Y * along)):
                total[i] += part
    return total


@pytest.mark.parametrize("ackermann", [0.0, 0.4, 1.0])
def test_a_double_track_is_four_wheels(ackermann):
    plain = make_car("vehicle=published")
    car = dataclasses.replace(plain, effects={"double_track": DoubleTrack(track_width=0.2, ackermann=ackermann)})
    state = states(plain, v_x=2.5, v_y=0.2, yaw_rate=3.0, delta=0.3, omega=2.7)
    motion = car.motion(state)
    forces = car.tyre_forces(car.slips(motion, TORCH), motion, TORCH)
    wrench = car.wrench(forces, motion, TORCH)
    found = [float(wrench.F_x + car.drag(motion.v_x, TORCH)), float(wrench.F_y), float(wrench.M_z)]
    assert found == pytest.approx(wheel_by_wheel(car, state, 0.2, ackermann), rel=1e-6, abs=1e-6)
    assert abs(found[2] - wheel_by_wheel(car, state, 0.0, ackermann)[2]) > 0.01  # N m


def test_a_double_track_without_width_is_a_single_one_and_none_has_a_side():
    plain = make_car("vehicle=published")
    state, command = random_states(plain, 200)
    single = dataclasses.replace(plain, effects={"double_track": DoubleTrack()})
    assert torch.allclose(single.derivative(state, command, TORCH), plain.derivative(state, command, TORCH), atol=1e-9)
    car = dataclasses.replace(plain, effects={"double_track": DoubleTrack(track_width=0.2, ackermann=0.3)})
    sides = torch.tensor([1.0, -1.0, -1.0, 1.0, -1.0, -1.0, -1.0, 1.0])[:, None]
    mirrored = car.derivative(sides * state, torch.tensor([[-1.0], [1.0]]) * command, TORCH)
    assert torch.allclose(mirrored, sides * car.derivative(state, command, TORCH), atol=1e-9)
    assert "double_track" not in catalogue.names()


def test_wheels_on_one_circle_roll_without_scrubbing():
    car = make_car("vehicle=published")
    radius, speed = 1.0, 2.0  # of the rear axle's middle
    delta = math.atan(float(car.wheelbase) / radius)
    still = {"v_x": speed, "v_y": speed / radius * float(car.l_r), "yaw_rate": speed / radius, "delta": delta}
    aside = {}
    for ackermann in (0.0, 1.0):
        on = dataclasses.replace(car, effects={"double_track": DoubleTrack(track_width=0.2, ackermann=ackermann)})
        motion = on.motion(states(on, **still, omega=speed))
        rolling = on.slips(motion, TORCH)._replace(kappa_f=torch.zeros(1), kappa_r=torch.zeros(1))
        own = on.effects["double_track"]._side(1.0, on.tyre_forces(rolling, motion, TORCH), rolling, motion, TORCH)
        aside[ackermann] = abs(float(own.F_yf))
    assert aside[1.0] < 1e-6 and aside[0.0] > 1.0
