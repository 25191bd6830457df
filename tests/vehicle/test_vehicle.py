"""Properties of the derivative that hold for every kind of car."""

import dataclasses
from collections.abc import Callable

import casadi
import numpy as np
import pytest
import torch

from racerl import registry
from racerl.record.ability import _static_loads
from racerl.record.record import slips
from racerl.vehicle import effects
from racerl.vehicle.effects import Effect
from racerl.vehicle.integrate import advance
from racerl.vehicle.ops import TORCH, CasadiOps
from racerl.vehicle.parameter import replace_values, specifications, values
from racerl.vehicle.vehicle import GRAVITY, STATE, Vehicle
from tests.vehicle.conftest import EFFECTS, make_car, random_states, travel

ODD = ("y", "yaw", "v_y", "yaw_rate", "delta")  # change sign in the mirror
EVEN = (
    "clock",
    "heat",
    "longitudinal_load_transfer.acceleration",
    "drive_split.apart",
)  # of the effects' states; the others are odd


def mirror(car: Vehicle, state: torch.Tensor) -> torch.Tensor:
    odd = [name in ODD or ("." in name and not name.endswith(EVEN)) for name in car.states]
    return torch.where(torch.tensor(odd)[:, None], -state, state)


def only(car: Vehicle, kept: Callable[[Effect], bool]) -> Vehicle:
    return dataclasses.replace(car, effects={name: effect for name, effect in car.effects.items() if kept(effect)})


@pytest.mark.parametrize("slow", [False, True])
def test_torch_and_casadi_agree(any_car, slow):
    state, command = random_states(any_car, 500, slow=slow)
    x, u = casadi.SX.sym("x", len(any_car.states)), casadi.SX.sym("u", 2)
    function = casadi.Function("f", [x, u], [any_car.derivative(x, u, CasadiOps())])
    expected = np.array(function.map(500)(state.numpy(), command.numpy()))
    got = any_car.derivative(state, command, TORCH).numpy()
    assert (np.abs(got - expected) / (1.0 + np.abs(expected))).max() < 1e-10


def test_jacobians_of_torch_and_casadi_agree(car):
    state, command = random_states(car, 20)
    x, u = casadi.SX.sym("x", len(car.states)), casadi.SX.sym("u", 2)
    jacobian = casadi.Function("J", [x, u], [casadi.jacobian(car.derivative(x, u, CasadiOps()), x)])
    for i in range(20):
        got = torch.autograd.functional.jacobian(
            lambda s, i=i: car.derivative(s[:, None], command[:, i : i + 1], TORCH)[:, 0], state[:, i]
        )
        expected = np.array(jacobian(state[:, i].numpy(), command[:, i].numpy()))
        assert np.abs(got.numpy() - expected).max() < 1e-9 * (1 + np.abs(expected).max())


@pytest.mark.parametrize("slow", [False, True])
def test_mirrored_drive_is_the_mirror_image(any_car, slow):
    any_car = only(any_car, lambda effect: effect.symmetric)
    state, command = random_states(any_car, 500, slow=slow)
    flipped = torch.stack([-command[0], command[1]])
    left = any_car.derivative(state, command, TORCH)
    right = any_car.derivative(mirror(any_car, state), flipped, TORCH)
    assert torch.allclose(mirror(any_car, left), right, rtol=1e-12, atol=1e-12)


ASYMMETRIC = [name for name in EFFECTS if not registry.lookup(effects, name).symmetric]


@pytest.mark.parametrize("name", ASYMMETRIC)
def test_what_is_called_asymmetric_breaks_the_mirror(name):
    car = make_car(f"+vehicle/effect={name}")
    state, command = random_states(car, 50)
    flipped = torch.stack([-command[0], command[1]])

    def outcome(state, command):
        rates = car.derivative(state, command, TORCH)
        shown = car.measured(dict(zip(STATE, state, strict=False)), TORCH)
        return torch.cat([rates, torch.stack([shown[name] for name in STATE])])

    left, right = outcome(state, command), outcome(mirror(car, state), flipped)
    count = len(car.states)
    assert not torch.allclose(mirror(car, left[:count]), right[:count], rtol=1e-3) or not torch.allclose(
        mirror(car, left[count:])[:8], right[count:], rtol=1e-3
    )


def test_turning_the_world_turns_the_drive(any_car):
    any_car = only(any_car, lambda effect: effect.uniform or "clock" in effect.states or "heat" in effect.states)
    state, command = random_states(any_car, 200)
    turned = state.clone()
    turned[2] += 0.7
    a, b = any_car.derivative(state, command, TORCH), any_car.derivative(turned, command, TORCH)
    c, s = np.cos(0.7), np.sin(0.7)
    assert torch.allclose(b[0], c * a[0] - s * a[1]) and torch.allclose(b[1], s * a[0] + c * a[1])
    assert torch.allclose(b[2:], a[2:])


def kinetic_energy(car, state):
    _, _, _, v_x, v_y, r, _, omega = state[:8]
    return (car.mass * (v_x**2 + v_y**2) + car.yaw_inertia * r**2 + car.drive.rotating_mass * omega**2) / 2


def test_a_car_without_current_only_loses_energy():
    car = make_car("sim=motor_current")
    state, command = random_states(car, 60)
    command[1] = 0.0
    energy = torch.stack([kinetic_energy(car, each) for each in (state, *travel(car, state, command, 0.0002, 5000))])
    assert (energy.diff(dim=0) <= 1e-8).all()
    assert energy[-1].mean() < 0.8 * energy[0].mean()


def test_motor_current_is_limited_and_pushes():
    car = make_car("sim=motor_current")
    state = torch.zeros(8, 3, dtype=torch.float64)
    command = torch.tensor([[0.0, 0.0, 0.0], [10.0, 60.0, 600.0]], dtype=torch.float64)
    rate = car.derivative(state, command, TORCH)[7]
    force = 2.73e-3 * 11.8 * 0.85 / 0.055 * command[1].clamp(max=60.0)
    assert torch.allclose(rate, force / 0.5)
    moved = travel(car, state, command, 0.002, 500)[-1]
    assert (moved[3] > 0.3).all() and moved[3, 1] == moved[3, 2]


def test_a_parked_car_stays_parked(any_car):
    any_car = only(any_car, lambda effect: type(effect).__name__ not in ("RoadSlope", "RoadBank"))
    state = torch.zeros(len(any_car.states), 1, dtype=torch.float64)
    moved = travel(any_car, state, torch.zeros(2, 1, dtype=torch.float64), 0.002, 500)[-1]
    at_rest = moved[[0, 1, 3, 4, 5, 7]]
    assert torch.allclose(at_rest, torch.zeros_like(at_rest), atol=1e-9)


def test_a_sliding_car_comes_to_rest_without_shaking(car):
    state = torch.zeros(8, 1, dtype=torch.float64)
    state[3:6, 0] = torch.tensor([1.0, 0.8, 2.0])
    states = travel(car, state, torch.zeros(2, 1, dtype=torch.float64), 0.01, 600)
    assert torch.isfinite(states).all() and states[300:, 3:6].abs().max() < 1e-2


def test_slip_speed_is_smooth_at_its_seam(car):
    v = torch.tensor([0.5 - 1e-7, 0.5 + 1e-7], dtype=torch.float64, requires_grad=True)
    value = car.slip_speed(v, TORCH)
    slope = torch.autograd.grad(value.sum(), v)[0]
    assert abs(value[1] - value[0]) < 1e-6 and abs(slope[1] - slope[0]) < 1e-6


def test_steady_turn_matches_the_bicycle_at_low_slip(car):
    """At small slip the car yaws at r = v δ/L, corrected by its understeer gradient."""
    stiff = replace_values(car, {"front.p_Ky1": 150.0, "rear.p_Ky1": 150.0})
    state = torch.zeros(8, 1, dtype=torch.float64)
    state[3] = state[7] = 1.0
    command = torch.tensor([[0.05], [1.0]], dtype=torch.float64)
    moved = travel(stiff, state, command, 0.001, 3000)[-1]
    expected = moved[3] * np.tan(0.05) / 0.33
    assert torch.allclose(moved[5], expected, rtol=0.02)


def test_gradient_through_a_rollout_matches_finite_differences(car):
    """∂(final state)/∂parameter of an 85-step rollout, for every kind of parameter."""
    names = ["mass", "l_f", "friction", "front.p_Ky1", "rear.p_Dy1", "rear.p_Kx1", "steering.time_constant"]
    state, command = random_states(car, 5, seed=3)
    state[3], state[4], state[5] = 3.0, 0.1, 0.3
    state[7] = 3.1
    command[0] *= 0.3
    command[1] = 3.2
    nominal = values(car)

    def final(table):
        """Return Σ(v_x, v_y, r) of the five cars' ends for every column of parameters (P, K)."""
        count = table.shape[1]
        changed = replace_values(car, dict(zip(names, table.repeat_interleave(5, dim=1), strict=True)))
        ends = advance(changed, state.repeat(1, count), command.repeat(1, count), 0.01, 85, TORCH)
        return ends[3:6].reshape(3, count, 5).sum(dim=(0, 2))

    point = torch.tensor([nominal[name] for name in names], dtype=torch.float64)[:, None].requires_grad_()
    gradient = torch.autograd.grad(final(point).sum(), point)[0][:, 0]
    h = 1e-5 * point.detach().abs().clamp(min=1e-3)
    above, below = (final(point.detach() + side * torch.diag(h[:, 0])) for side in (1, -1))
    difference = (above - below) / (2 * h[:, 0])
    assert (gradient - difference).abs().le(1e-4 * difference.abs().clamp(min=1.0)).all(), names


def test_cars_in_a_batch_have_their_own_parameters(car):
    state, command = random_states(car, 3)
    friction = torch.tensor([0.5, 0.8, 1.1], dtype=torch.float64)
    together = replace_values(car, {"friction": friction}).derivative(state, command, TORCH)
    for i in range(3):
        alone = replace_values(car, {"friction": float(friction[i])})
        one = alone.derivative(state[:, i : i + 1], command[:, i : i + 1], TORCH)
        assert torch.allclose(together[:, i : i + 1], one, rtol=1e-14, atol=1e-14)


def test_commands_act_at_once_without_actuators():
    car = make_car("sim=no_actuators")
    state, command = random_states(car, 10)
    moved = advance(car, state, command, 0.01, 1, TORCH)
    assert torch.equal(moved[STATE.index("delta")], command[0])
    assert torch.equal(moved[STATE.index("omega")], command[1])


def test_first_order_actuators_cover_63_percent_in_their_time_constant(car):
    state = torch.zeros(8, 1, dtype=torch.float64)
    command = torch.tensor([[0.4], [0.0]], dtype=torch.float64)
    moved = advance(car, state, command, 0.044 / 20, 20, TORCH)
    assert abs(float(moved[6]) / 0.4 - (1 - np.exp(-1))) < 1e-6


def test_every_parameter_has_unit_bounds_and_meaning(any_car):
    for name, specification in specifications(any_car).items():
        assert specification.low < specification.high and specification.meaning, name
        assert specification.low <= values(any_car)[name] <= specification.high, name


def test_what_is_told_of_a_drive_goes_by_where_the_centre_of_gravity_is():
    words = "+vehicle/effect=cog_longitudinal_offset", "vehicle.effects.cog_longitudinal_offset.offset=0.05"
    for car in (make_car(), make_car(*words)):
        front, rear = _static_loads(car)
        assert front + rear == pytest.approx(float(car.mass) * GRAVITY)
        states, _ = random_states(car, 20)
        states[3] = states[3].abs() + 1.0  # m/s, where no standstill rounds the slips
        told = slips(car, states[:8].T.numpy())
        steady = car.slips(car.motion(states), TORCH)
        assert np.tan(told["alpha_r"]).to_numpy() == pytest.approx(steady.alpha_r.numpy(), abs=1e-9)
        V_x, V_y = car.front_velocity(car.motion(states), TORCH)
        assert told["alpha_f"].to_numpy() == pytest.approx(-np.arctan2(V_y.numpy(), V_x.abs().numpy()), abs=1e-9)
