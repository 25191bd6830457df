"""Commands that act late: held means, and the race and the recorder that use them."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from racerl.assemble import build_race
from racerl.config import compose_settings
from racerl.vehicle.delay import held, periods
from racerl.vehicle.ops import TORCH
from tests.vehicle.conftest import make_car

STEP = 0.01


def sampled(history, delay, begin, length, period):
    """Return the mean of the held command by sampling it finely."""
    t = begin - delay + (np.arange(20_000) + 0.5) / 20_000 * length
    age = np.clip(-np.floor(t / period).astype(int), 0, len(history) - 1)
    return np.array(history)[age].mean()


@given(
    st.lists(st.floats(-1, 1), min_size=6, max_size=6),
    st.floats(0.0, 0.2),
    st.sampled_from([0.0, 0.01, 0.02, 0.03, 0.04]),
)
def test_a_held_command_is_averaged_exactly(history, delay, begin):
    got = held(history, delay, begin, STEP, 0.05, TORCH)
    assert got == pytest.approx(sampled(history, delay, begin, STEP, 0.05), abs=2e-3)


def test_as_many_commands_are_kept_as_are_needed():
    assert periods(make_car(), 0.05) == 0
    assert periods(make_car("+vehicle/effect=steering_delay", "vehicle.effects.steering_delay.delay=0.04"), 0.05) == 2


def race(*overrides):
    return build_race(compose_settings("train", ["dr=none", *overrides]), cars=3, seeds=[0])


def steered(built, steps=6):
    built.reset()
    angles = []
    for _ in range(steps):
        built.step(torch.tensor([[0.5, 0.0]]).expand(3, 2))
        angles.append(float(built.delta[0]))
    return np.array(angles)


def test_the_race_delays_steering_by_so_many_seconds():
    """A delay of one control period is the same drive one period later."""
    prompt = steered(race())
    late = steered(race("+vehicle/effect=steering_delay", "vehicle.effects.steering_delay.delay=0.05"))
    assert late[0] == pytest.approx(0.0, abs=1e-6)
    assert late[1:] == pytest.approx(prompt[:-1], rel=1e-4)


def test_the_race_delays_the_drive_by_so_many_seconds():
    def wheel_speeds(*overrides):
        built = race(*overrides)
        built.reset()
        speeds = []
        for _ in range(6):
            built.step(torch.tensor([[0.0, 1.0]]).expand(3, 2))
            speeds.append(float(built.omega[0]))
        return np.array(speeds)

    prompt = wheel_speeds()
    late = wheel_speeds("+vehicle/effect=drive_delay", "vehicle.effects.drive_delay.delay=0.05")
    assert prompt[0] > late[0] + 0.01
    assert late[1:] == pytest.approx(prompt[:-1], rel=1e-3)


def test_a_part_of_a_period_lies_between():
    none, half, whole = (
        steered(race("+vehicle/effect=steering_delay", f"vehicle.effects.steering_delay.delay={delay}"))[1]
        for delay in (0.0, 0.025, 0.05)
    )
    assert whole < half < none


def test_a_snapshot_keeps_what_is_still_on_its_way():
    built = race("+vehicle/effect=steering_delay", "vehicle.effects.steering_delay.delay=0.12")
    built.reset()
    for _ in range(3):
        built.step(torch.tensor([[0.5, 0.1]]).expand(3, 2))
    kept = built.snapshot()
    after = [built.step(torch.zeros(3, 2)).observation.clone() for _ in range(4)]
    built.restore(kept)
    again = [built.step(torch.zeros(3, 2)).observation.clone() for _ in range(4)]
    assert all(torch.equal(a, b) for a, b in zip(after, again, strict=True))
