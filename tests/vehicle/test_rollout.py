"""Rollouts and their sensitivities: compiled against torch, against finite differences, for cars of every kind."""

import dataclasses
import shutil
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import numpy as np
import pytest
import torch

from racerl.vehicle import rollout as rollout_module
from racerl.vehicle.effects.aero_drag import AeroDrag
from racerl.vehicle.ops import TORCH, symbolic
from racerl.vehicle.parameter import replace_values, values
from racerl.vehicle.rollout import Rollout, Windows, drive_by, roll_out
from tests.vehicle.conftest import random_states

needs_compiler = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler on this machine")
OBSERVED = ("v_x", "v_y", "yaw_rate")
NAMES = ("yaw_inertia", "l_f", "front.p_Ky1", "rear.p_Dy1", "rear.r_Bx1")


def windows_for(car, observed=OBSERVED, count=11, length=12, dt=0.01, seed=0):
    state, command = random_states(car, count, seed)
    state[3], state[7] = 2.0 + state[3].abs() / 3, 2.0 + state[3].abs() / 3
    command = 0.3 * command
    command[1] += 2.0
    generator = np.random.default_rng(seed)
    inputs = command.numpy()[None] + 0.2 * generator.standard_normal((length, 2, count))
    measured = generator.standard_normal((length + 1, len(observed), count))
    weight = generator.uniform(0.5, 2.0, (len(observed), count))
    return Windows(state.numpy(), inputs, measured, weight, dt)


def without_compiler(car, names, observed, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(rollout_module, "build", lambda code, effort: None)
        slow = Rollout(car, names, observed)
    assert not slow.compiled
    return slow


@needs_compiler
def test_compiled_rollouts_are_torchs(built_car):
    names = [name for name in NAMES if name in values(built_car)]
    windows = windows_for(built_car, length=20, dt=0.001 if hasattr(built_car.drive, "current_limit") else 0.01)
    compiled = Rollout(built_car, names, OBSERVED)
    theta = compiled.nominal() * 1.1
    car = replace_values(built_car, dict(zip(names, theta, strict=True)))
    initial, inputs = torch.as_tensor(windows.initial), torch.as_tensor(windows.inputs)
    expected = roll_out(partial(car.derivative, ops=TORCH), initial, inputs, 1, windows.dt).numpy()
    rows = [built_car.states.index(name) for name in compiled.active]
    got, expected = compiled.simulate(theta, windows)[:, rows], expected[:, rows]
    assert np.abs((got - expected) / (1 + np.abs(expected))).max() < 1e-10


@needs_compiler
def test_normal_equations_are_the_residuals_derivatives(built_car):
    """H = JᵀJ and g = Jᵀe with the Jacobian by central differences of the simulated residuals."""
    names = [name for name in NAMES if name in values(built_car)]
    windows = windows_for(built_car, count=3, dt=0.001 if hasattr(built_car.drive, "current_limit") else 0.01)
    rollout = Rollout(built_car, names, OBSERVED)
    theta = rollout.nominal()
    states = built_car.states

    def residual(theta, initial):
        moved = dataclasses.replace(windows, initial=initial)
        return windows.weight * (rollout.predict(theta, moved) - windows.measured)

    columns = []
    for i in range(rollout.size):
        up, down = (theta.copy(), windows.initial.copy()), (theta.copy(), windows.initial.copy())
        if i < len(names):
            h = 1e-6 * max(abs(theta[i]), 0.1)
            up[0][i] += h
            down[0][i] -= h
        else:
            h, row = 1e-6, states.index(rollout.active[i - len(names)])
            up[1][row] += h
            down[1][row] -= h
        columns.append((residual(*up) - residual(*down)) / (2 * h))
    J, e = np.stack(columns), residual(theta, windows.initial)
    got = rollout.accumulate(theta, windows)
    H, g = np.einsum("itcw,jtcw->wij", J, J), np.einsum("itcw,tcw->wi", J, e)
    # a state that is forgotten at once (the play behind a stiff linkage) moves the residual less than round-off does
    scale = np.sqrt(np.einsum("wii->wi", H)) + 1e-4
    assert np.abs((got.H - H) / (scale[:, :, None] * scale[:, None, :])).max() < 1e-4
    assert np.abs((got.g - g) / scale).max() < 1e-4 * np.sqrt((e**2).sum())
    assert np.allclose(got.squares, (e**2).sum(axis=0).T, rtol=1e-12)


@needs_compiler
def test_without_a_compiler_torch_gives_the_same(car, monkeypatch):
    windows = windows_for(car, count=4, length=6)
    compiled, slow = Rollout(car, NAMES, OBSERVED), without_compiler(car, NAMES, OBSERVED, monkeypatch)
    theta = compiled.nominal()
    assert np.allclose(slow.predict(theta, windows), compiled.predict(theta, windows), rtol=1e-10, atol=1e-12)
    expected, got = compiled.accumulate(theta, windows), slow.accumulate(theta, windows)
    for part in ("H", "g", "squares"):
        exact = getattr(expected, part)
        assert np.abs(getattr(got, part) - exact).max() < 1e-10 * np.abs(exact).max()


@needs_compiler
def test_threads_and_neighbours_change_nothing(car):
    windows = windows_for(car, count=200)
    rollout = Rollout(car, NAMES, OBSERVED)
    theta = rollout.nominal()
    one = rollout.accumulate(theta, windows)
    with rollout_module.on_threads(2):
        two = rollout.accumulate(theta, windows)
    alone = rollout.accumulate(theta, windows.take(np.array([77])))
    assert np.array_equal(one.H, two.H) and np.array_equal(one.g, two.g)
    assert np.allclose(one.H[77], alone.H[0], rtol=1e-12)


def test_one_thread_at_a_time_builds_expressions():
    inside, most = [], []

    @symbolic
    def build(number):
        inside.append(number)
        time.sleep(0.01)
        most.append(len(inside))
        inside.remove(number)
        return number

    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(build, range(8))) == list(range(8))
    assert max(most) == 1


@needs_compiler
def test_threads_may_take_turns_anywhere_in_a_call(car, monkeypatch):
    """Every line of a call lets the other threads go on; what they share of the kernel must not change meanwhile."""

    def turn(frame, event, argument):
        if frame.f_code.co_name != "_call":
            return None
        time.sleep(1e-5)
        return turn

    monkeypatch.setattr(rollout_module, "CHUNK", rollout_module.LANES)
    windows = windows_for(car, count=50 * rollout_module.LANES, length=1)
    rollout = Rollout(car, NAMES, OBSERVED)
    theta = rollout.nominal()
    expected = rollout.accumulate(theta, windows)
    threading.settrace(turn)
    try:
        with rollout_module.on_threads(8):
            got = rollout.accumulate(theta, windows)
    finally:
        threading.settrace(None)
    assert np.array_equal(got.H, expected.H) and np.array_equal(got.squares, expected.squares)


@needs_compiler
def test_threads_are_those_of_one_thread_and_change_nothing(car, monkeypatch):
    windows = windows_for(car, count=5 * rollout_module.CHUNK + 3)
    rollout, asked = Rollout(car, NAMES, OBSERVED), []

    def pool(threads):
        asked.append(threads)
        return ThreadPoolExecutor(threads)

    monkeypatch.setattr(rollout_module, "ThreadPoolExecutor", pool)
    theta = rollout.nominal()
    alone = rollout.accumulate(theta, windows)
    with rollout_module.on_threads(3), ThreadPoolExecutor(1) as other:
        together = rollout.accumulate(theta, windows)
        assert asked == [3]
        elsewhere = other.submit(rollout.accumulate, theta, windows).result()
    rollout.squares(theta, windows)
    assert asked == [3]
    for got in (together, elsewhere):
        assert np.array_equal(got.H, alone.H) and np.array_equal(got.g, alone.g)


@pytest.mark.parametrize("compiled", [pytest.param(True, marks=needs_compiler), False])
def test_squares_are_those_of_what_is_predicted(car, compiled, monkeypatch):
    windows = windows_for(car, count=75 if compiled else 5)
    rollout = Rollout(car, NAMES, OBSERVED) if compiled else without_compiler(car, NAMES, OBSERVED, monkeypatch)
    theta = rollout.nominal() * 1.1
    errors = windows.weight * (rollout.predict(theta, windows) - windows.measured)
    with rollout_module.on_threads(2):
        assert np.allclose(rollout.squares(theta, windows), (errors**2).sum(axis=0).T, rtol=1e-9)
    assert np.allclose(rollout.squares(theta, windows), rollout.accumulate(theta, windows).squares, rtol=1e-9)


@pytest.mark.parametrize(
    "compiled", [pytest.param(True, marks=needs_compiler), pytest.param(False, marks=pytest.mark.slow)]
)
def test_windows_may_have_parameters_of_their_own(car, compiled, monkeypatch):
    """One call for windows × parameter sets, an effect on in one of them, is what a call for each gives."""
    car = dataclasses.replace(car, effects={"aero_drag": AeroDrag(coefficient=0.0)})
    names = ["front.p_Ky1", "effects.aero_drag.coefficient"]
    windows = windows_for(car, count=70 if compiled else 5)
    rollout = Rollout(car, names, OBSERVED) if compiled else without_compiler(car, names, OBSERVED, monkeypatch)
    sets = [rollout.nominal() * [1.0, 0.0], rollout.nominal() * [1.2, 0.0] + [0.0, 0.5]]
    apart = [rollout.accumulate(theta, windows) for theta in sets]
    both = windows.take(np.tile(np.arange(windows.count), 2))
    table = np.repeat(np.stack(sets, axis=1), windows.count, axis=1)
    with rollout_module.on_threads(2):
        together = rollout.accumulate(table, both)
    for part in ("H", "g", "squares"):
        expected = np.concatenate([getattr(one, part) for one in apart])
        assert np.allclose(getattr(together, part), expected, rtol=1e-9, atol=1e-9)
    assert not np.allclose(apart[0].squares, apart[1].squares)
    states = np.concatenate([rollout.simulate(theta, windows) for theta in sets], axis=2)
    assert np.allclose(rollout.simulate(table, both), states, rtol=1e-9, atol=1e-9)


def test_only_states_that_matter_are_active(car):
    assert Rollout(car, [], OBSERVED).active == ["v_x", "v_y", "yaw_rate", "delta", "omega"]
    driven = drive_by(car, measured_steering=True, measured_speed=False)
    assert Rollout(driven, [], OBSERVED).active == ["v_x", "v_y", "yaw_rate", "omega"]
    assert Rollout(car, [], ("delta",)).active == ["delta"]
    assert Rollout(car, [], ("x", "y")).active == ["x", "y", "yaw", "v_x", "v_y", "yaw_rate", "delta", "omega"]


def test_long_samples_are_integrated_in_several_steps(car):
    coarse, fine = windows_for(car, length=4, dt=0.05), windows_for(car, length=20, dt=0.01)
    fine = dataclasses.replace(fine, inputs=np.repeat(coarse.inputs, 5, axis=0), initial=coarse.initial)
    rollout = Rollout(car, [], OBSERVED)
    theta = rollout.nominal()
    assert np.allclose(rollout.simulate(theta, coarse)[1:], rollout.simulate(theta, fine)[5::5], rtol=1e-9, atol=1e-12)
