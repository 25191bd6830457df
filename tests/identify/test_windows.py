"""Windows never cross runs, and what drives the car is chosen from what was logged."""

import numpy as np
import pandas as pd
import pytest

from racerl.data.log import Log, separate
from racerl.errors import LogError
from racerl.identify.windows import channel_scale, choose_wiring, cut
from racerl.vehicle.actuator import FirstOrder, Instant
from racerl.vehicle.vehicle import STATE
from tests.vehicle.conftest import make_car


def drive(rows=(200, 150, 40), **channels):
    """A log whose channels count the rows, so that a window shows where it came from."""
    n = sum(rows)
    count = np.arange(n, dtype=float)
    run = np.repeat(np.arange(len(rows)), rows)
    table = {"t": count * 0.01, "run": run}
    table |= dict.fromkeys(("v_x", "v_y", "yaw_rate", "delta", "omega"), 1.0 + count * 0.01)
    table["delta"] = np.sin(count)
    table |= {name: values for name, values in channels.items() if values is not None}
    return Log.from_table("drive", pd.DataFrame({k: v for k, v in table.items() if channels.get(k, 0) is not None}))


def test_windows_stay_within_runs():
    log, car = drive(), make_car()
    wiring = choose_wiring([log])
    windows = cut([log], wiring, wiring.driven(car), length=50, stride=10, slowest=0.0)
    steps = np.diff(windows.windows.measured[:, 0], axis=0)
    assert np.allclose(steps, 0.01), "a window that crossed a run or a gap would jump"
    starts = {(run, start) for run, start in zip(windows.run.tolist(), windows.start.tolist(), strict=True)}
    assert starts == {(0, s) for s in range(0, 150, 10)} | {(1, s) for s in range(0, 100, 10)}


def test_inputs_act_on_the_sample_that_follows():
    log = drive()
    wiring = choose_wiring([log])
    windows = cut([log], wiring, wiring.driven(make_car()), 5, 5, 0.0).windows
    delta = log.array("delta")  # measured: its mean over each sample
    assert np.allclose(windows.inputs[:, 0, 0], 0.5 * (delta[:5] + delta[1:6]))
    assert windows.initial[6, 0] == log.array("delta")[0] and windows.initial[3, 0] == log.array("v_x")[0]


def test_what_drives_the_car():
    n = 390
    commands = {"delta_ref": np.zeros(n), "omega_ref": np.ones(n)}
    full, car = drive(**commands), make_car()
    assert choose_wiring([full]).observed == ("v_x", "v_y", "yaw_rate", "delta", "omega")
    assert choose_wiring([full], "measured").observed == ("v_x", "v_y", "yaw_rate")
    half = choose_wiring([drive(delta_ref=commands["delta_ref"], delta=None)])
    assert (half.steering, half.drive) == ("delta_ref", "omega")
    driven = half.driven(car)
    assert isinstance(driven.steering, FirstOrder) and isinstance(driven.drive, Instant)
    # together, logs are driven by what all of them have
    assert choose_wiring([full, drive()]).steering == "delta"


@pytest.mark.parametrize(
    "channels, inputs, said",
    [
        ({"v_y": None}, "auto", "v_y missing"),
        ({"delta": None}, "auto", "needs one of delta, delta_ref"),
        ({}, "commands", "delta_ref missing"),
    ],
)
def test_what_cannot_be_done_without(channels, inputs, said):
    with pytest.raises(LogError, match=said) as error:
        choose_wiring([drive(**channels)], inputs)
    assert "\n" not in str(error.value)


def test_short_slow_and_still_logs_are_refused_in_one_line():
    car, log = make_car(), drive()
    wiring = choose_wiring([log])
    with pytest.raises(LogError, match="longest run has 200 samples, a window needs 301"):
        cut([log], wiring, wiring.driven(car), 300, 10, 0.0)
    with pytest.raises(LogError, match="never stays above 30 m/s"):
        cut([log], wiring, wiring.driven(car), 50, 10, 30.0)
    with pytest.raises(LogError, match="v_y never changes"):
        channel_scale([drive(v_y=np.zeros(390))], ("v_x", "v_y"))


@pytest.mark.parametrize("reached", [2.0, 1.3])
def test_a_speed_that_is_always_commanded_is_where_windows_begin_only_where_it_is_reached(reached):
    noise = 0.01 * np.random.default_rng(0).standard_normal(390)
    log = drive(omega_ref=np.full(390, 2.0), omega=reached + noise, delta_ref=np.sin(np.arange(390.0)))
    wiring = choose_wiring([log])
    begin = cut([log], wiring, wiring.driven(make_car()), 50, 10, 0.0).windows.initial[STATE.index("omega")]
    assert (begin == 2.0).all() if reached == 2.0 else begin == pytest.approx(1.3, abs=0.05)


def test_a_launch_to_the_speed_that_is_always_commanded_is_no_standing_there():
    rising = 2.0 * (1.0 - np.exp(-np.arange(390.0) / 60.0))
    log = drive(omega_ref=np.full(390, 2.0), omega=rising, delta_ref=np.sin(np.arange(390.0)))
    wiring = choose_wiring([log])
    found = cut([log], wiring, wiring.driven(make_car()), 50, 10, 0.0)
    assert found.still(wiring) == () and found.windows.initial[STATE.index("omega"), 0] == 0.0


def test_slow_windows_are_left_out():
    log = drive()
    wiring = choose_wiring([log])
    fast = cut([log], wiring, wiring.driven(make_car()), 50, 10, 2.0)
    assert (fast.windows.measured[:, 0] > 2.0).all() and fast.windows.count > 0


def test_copies_of_runs_are_left_out():
    log = drive()
    kept, said = separate([log, drive()])
    assert len(kept) == 1 and "3 runs are copies" in said[0]
    assert separate([log]) == ([log], [])


def test_effects_over_time_begin_with_the_logs_time_and_lags_where_they_rest():
    car = make_car("+vehicle/effect=[friction_fade,tyre_relaxation]")
    log = drive()
    wiring = choose_wiring([log])
    windows = cut([log], wiring, wiring.driven(car), 50, 10, 0.0)
    clock, lag = car.states.index("friction_fade.clock"), car.states.index("tyre_relaxation.alpha_r")
    first = {run: log.table["t"][log.table["run"] == run].iloc[0] for run in (0, 1)}
    begun = np.array([first[run] for run in windows.run.tolist()]) + 0.01 * windows.start
    assert np.allclose(windows.windows.initial[clock], begun)
    v_x, v_y, r = windows.windows.initial[3:6]
    assert np.allclose(windows.windows.initial[lag], -(v_y - car.l_r * r) / v_x)
