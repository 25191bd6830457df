"""The engine: stages, shifts in time, sensitivities, states led by a whole log, and the name of a hidden effect."""

import dataclasses
import shutil
import time
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from scipy.signal import butter, filtfilt

from racerl.documents import conf_folder
from racerl.estimation.pseudo_huber import pseudo_huber, slope
from racerl.estimation.unknowns import Unknown, choose_unknowns
from racerl.gap import investigation, nominal, screening
from racerl.gap.candidates import add, joined
from racerl.gap.catalogue import starts
from racerl.gap.evidence import SMOOTH, Evidence
from racerl.gap.fit_data import FitData
from racerl.gap.fitted_model import COG, fit_model
from racerl.gap.follow import follow, lagged
from racerl.gap.kernels import StageKernels
from racerl.gap.naming import name_effects
from racerl.gap.presence import with_all
from racerl.gap.problem import Landscape, Place, Problem
from racerl.gap.score import summed
from racerl.gap.screening import Screened, beyond, scores, screen
from racerl.gap.shapes import SHAPES
from racerl.gap.stage import CHASSIS, DRIVE, STEERING
from racerl.gap.stage_fit import WAYS, StageFit
from racerl.gap.stage_problem import StageProblem
from racerl.gap.uncertainty import deviations
from racerl.gap.verdict import judge
from racerl.vehicle import catalogue
from racerl.vehicle.ops import TORCH
from racerl.vehicle.parameter import replace_values, values
from racerl.vehicle.rollout import Windows
from racerl.vehicle.vehicle import STATE
from tests.gap.conftest import configured, drive, investigate
from tests.vehicle.conftest import make_car, random_states

needs_compiler = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler on this machine")


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("steering_delay", {"steering": (1, 0), "drive": (0, 0), "chassis": (0, 0)}),
        ("drive_delay", {"steering": (0, 0), "drive": (0, 1), "chassis": (0, 0)}),
        ("pose_latency", {"steering": (0, 0), "drive": (0, 0), "chassis": (1, 1)}),
        ("command_timestamp_offset", {"steering": (0, 0), "drive": (0, 0), "chassis": (-1, -1)}),
        ("steering_sensor_latency", {"steering": (1, 1), "drive": (-1, 0), "chassis": (-1, 0)}),
    ],
)
def test_what_is_late_shifts_the_stages_that_it_should(name, expected):
    effect = make_car(f"+vehicle/effect={name}").effects[name]
    for stage in (STEERING, DRIVE, CHASSIS):
        assert stage.shifts(effect) == pytest.approx(np.array(expected[stage.name]) * 0.02, abs=1e-12)


def test_an_input_is_shifted_by_so_many_seconds(clean):
    evidence = Evidence.of([clean], CHASSIS, 40, 0.5)
    states = make_car().states
    now, later = (evidence.windows(states, (shift, 0.0)).inputs for shift in (0.0, 0.05))
    assert np.allclose(later[5:, 0], now[:-5, 0], atol=1e-12)  # 5 samples of 0.01 s
    assert np.allclose(later[:, 1], now[:, 1])
    commands = Evidence.of([clean], STEERING, 40, 0.5)
    half, whole = (commands.windows(states, (shift, 0.0)).inputs[:, 0] for shift in (0.005, 0.01))
    none = commands.windows(states, (0.0, 0.0)).inputs[:, 0]
    assert np.allclose(half, (none + whole) / 2)


@pytest.mark.parametrize("sent", [0.0, 0.001, 0.002, 0.005, 0.0095])
def test_commands_that_were_sent_between_samples_are_timed(clean, sent, monkeypatch):
    steering = Evidence.of([clean], STEERING, 85, 0.5)
    least = steering.numbers * len(steering.start)

    def fit(data, *asked, stages):  # a shift leaves errors in proportion to it
        off = data.evidence["steering"].early - sent
        return SimpleNamespace(cost={"steering": np.array([least * (1.0 + (off / 0.002) ** 2)])})

    monkeypatch.setattr(nominal, "fit_model", fit)
    data = FitData({"steering": steering}, *([None] * 10))
    assert nominal.timed(data).evidence["steering"].early == pytest.approx(sent, abs=0.0003)


def test_inputs_are_smoothed_as_far_as_only_noise_is_lost(clean):
    lively = Evidence.of([clean], CHASSIS, 85, 0.5)
    assert np.allclose(lively.smoothed["omega"][0], lively._filtered("omega", min(SMOOTH)))
    truth = 2.0 + 0.5 * np.sin(0.01 * np.arange(len(lively.first)))
    shown = truth + 0.02 * np.random.default_rng(0).standard_normal(len(truth))
    slow = dataclasses.replace(lively, columns={**lively.columns, "omega": shown})
    assert (slow.smoothed["omega"][0] - truth).std() < 0.35 * 0.02  # a filter over five samples leaves 0.7 of it


def test_the_noise_of_every_channel_is_found(clean):
    chassis = Evidence.of([clean], CHASSIS, 40, 0.5)
    noise = dict(zip(chassis.observed, chassis.noise(), strict=True))
    assert noise["x"] == pytest.approx(0.0005, rel=0.1) and noise["yaw"] == pytest.approx(0.001, rel=0.1)
    assert Evidence.of([clean], STEERING, 40, 0.5).noise()[0] == pytest.approx(0.002, rel=0.1)


def test_the_noise_of_a_log_in_fragments_is_that_of_its_long_runs(clean):
    """Fragments of eight samples show none, and half of the rows are in such."""
    t, rows = clean.table["t"].to_numpy(), np.arange(len(clean.table))
    half = len(rows) // 2
    runs = np.where(rows < half, 0, 1 + (rows - half) // 8)
    log = dataclasses.replace(clean, table=clean.table.assign(run=runs, t=t + 5.0 * runs))
    assert Evidence.of([log], STEERING, 40, 0.5).noise()[0] == pytest.approx(0.002, rel=0.1)
    short = dataclasses.replace(log, table=log.table[runs > 0])
    assert Evidence.of([short], STEERING, 40, 0.5).noise()[0] == 1e-9


@pytest.mark.parametrize("cut_off", [20.0, 15.0, 12.0])
def test_the_noise_of_a_filtered_channel_is_what_the_filter_left(clean, cut_off):
    """Above a filter's cut-off there is no noise to be seen, and motion hides it below; a seventh was told before."""
    chassis = Evidence.of([clean], CHASSIS, 40, 0.5)
    b, a = butter(2, cut_off, fs=100.0)
    kept = float(np.std(filtfilt(b, a, np.random.default_rng(0).standard_normal(100_000))))
    columns = dict(chassis.columns)
    for name in chassis.observed:
        columns[name] = np.concatenate([filtfilt(b, a, columns[name][run]) for run in chassis.runs])
    found = dataclasses.replace(chassis, columns=columns).noise() / chassis.noise()
    assert found == pytest.approx(np.full(3, kept), rel=0.2)


def test_motion_that_is_faster_than_samples_taken_is_no_noise(clean):
    """Without noise no sample more is left out: what local polynomials do not follow is the motion's."""
    chassis = Evidence.of([clean], CHASSIS, 40, 0.5)
    t = chassis.columns["t"]
    moved = dataclasses.replace(chassis, columns={**chassis.columns, "yaw_rate": np.sin(2 * np.pi * 4.0 * t)})
    assert moved.noise_of(["yaw_rate"])[0] < 1e-3


def test_filtered_sensors_are_told_from_noisy_ones(clean):
    noisy = Evidence.of([clean], CHASSIS, 40, 0.5)
    mean = {name: np.convolve(noisy.columns[name], [0.25, 0.5, 0.25], "same") for name in noisy.observed}
    assert not noisy.filtered and dataclasses.replace(noisy, columns={**noisy.columns, **mean}).filtered


def test_velocities_that_were_made_from_poses_are_told_from_measured_ones(clean):
    assert Evidence.of([clean], CHASSIS, 40, 0.5).observed == ("x", "y", "yaw")
    table, generator = clean.table.copy(), np.random.default_rng(0)
    for name in ("v_x", "v_y", "yaw_rate"):
        table[name] += 0.01 * generator.standard_normal(len(table))
    measured = dataclasses.replace(clean, table=table)
    assert Evidence.of([measured], CHASSIS, 40, 0.5).observed == CHASSIS.outputs


def test_an_unmeasured_actuator_is_where_a_command_that_never_changes_puts_it(clean):
    """Else a free angle in every window, and a slow actuator, pass for what the car does on a circle."""
    unmeasured = clean.table.drop(columns=["delta"])
    for command, known in ((0.15, True), (unmeasured["delta_ref"], False)):
        log = dataclasses.replace(clean, table=unmeasured.assign(delta_ref=command))
        evidence = Evidence.of([log], dataclasses.replace(CHASSIS, inputs=("delta_ref", "omega")), 40, 0.5)
        assert (evidence.trust("delta") > 1e9) == known
        assert evidence.trust("v_y") == 0.0


def test_a_measured_actuator_that_stands_tells_nothing_of_how_fast_it_is(clean):
    wave, noise = np.sin(clean.table["t"]), 0.002 * np.random.default_rng(0).standard_normal(len(clean.table))
    for delta, stands in ((0.2 + noise + 0.02 * wave, False), (0.2 + noise, True)):
        log = dataclasses.replace(clean, table=clean.table.assign(delta_ref=0.2, delta=delta))
        evidence = Evidence.of([log], STEERING, 85, 0.5)
        assert (evidence.trust("delta") > 1e9) == stands
        assert (evidence.windows(["delta"], (0.0, 0.0)).initial == 0.2).all() == stands
    vehicle, priors = configured()
    short = dataclasses.replace(log, table=log.table.assign(delta_ref=0.3))  # it stops before it is there
    stopped = Evidence.of([short], STEERING, 85, 0.5)
    assert stopped.trust("delta") == 0.0
    assert stopped.windows(["delta"], (0.0, 0.0)).initial == pytest.approx(0.2, abs=0.01)
    found = investigation.investigate(
        {"steering": evidence}, vehicle, choose_unknowns(vehicle, priors, [], vehicle), {}
    )
    time_constant = found.base.theta["steering.time_constant"]
    assert time_constant == pytest.approx(vehicle.steering.time_constant, rel=1e-3)  # it followed the noise before


def test_a_stage_that_lacks_channels_is_left_out(clean):
    poor = dataclasses.replace(clean, table=clean.table.drop(columns=["delta_ref", "omega"]))
    assert [Evidence.of([poor], stage, 40, 0.5) is None for stage in (STEERING, DRIVE, CHASSIS)] == [True, True, True]
    silent = dataclasses.replace(clean, table=clean.table.drop(columns=["delta_ref"]))
    assert [Evidence.of([silent], stage, 40, 0.5) is None for stage in (STEERING, DRIVE, CHASSIS)] == [
        True,
        False,
        False,
    ]


@needs_compiler
def test_a_parameter_that_states_remember_counts_with_what_it_did_before_the_window(clean):
    """Cost and its slope by the time in which tyres warm up: mostly, how warm they are when a window begins."""
    evidence = Evidence.of([clean], CHASSIS, 40, 0.5)
    car = make_car("vehicle=published", "+vehicle/effect=tyre_heating", "vehicle.effects.tyre_heating.loss=0.4")
    theta = {"effects.tyre_heating.loss": 0.4, "effects.tyre_heating.time": 15.0}
    unknowns = [Unknown(name, value, value, 0.1 * value, 10.0 * value) for name, value in theta.items()]
    kernels = StageKernels(evidence, make_car("vehicle=published"), [], car.effects)
    problem = StageProblem.of(evidence, kernels, car, unknowns, evidence.noise())
    assert set(problem.memory.values()) == {"effects.tyre_heating.time"}
    work = StageFit(problem, theta, None)
    line = work.linearise(theta)
    for i, name in enumerate(problem.names):
        step = 1e-3 * theta[name]
        above, below = (work.linearise({**theta, name: theta[name] + way * step}).cost.sum() for way in (1, -1))
        assert 2.0 * line.t[:, i].sum() == pytest.approx((above - below) / (2.0 * step), rel=0.02)
    # the same drive, fitted from a wrong time: what a fit ends with is where another one may begin, but for what
    # another grip changes in the heat
    fit = Problem([problem], unknowns).fit({**theta, "effects.tyre_heating.time": 40.0}, iterations=5)
    again = Problem([dataclasses.replace(problem, vehicle=replace_values(car, fit.theta))], unknowns)
    (now,), (before,) = again.fit(fit.theta, fit.initial, iterations=0).cost, fit.cost
    assert now.sum() == pytest.approx(before.sum(), rel=2e-3)


@needs_compiler
def test_where_windows_begin_explains_nothing_of_what_a_model_is_far_from(clean):
    """A body that rolled before a window would else take up a floor that has less grip than the model's."""
    evidence = Evidence.of([clean], CHASSIS, 40, 0.5)
    car = make_car("vehicle=published", "vehicle.friction=1.2", "+vehicle/effect=roll_dynamics")
    loss = Unknown("effects.roll_dynamics.loss", 0.02, 0.06, 0.0, 0.2, effect=True)
    kernels = StageKernels(evidence, make_car("vehicle=published"), [], car.effects)
    stage = StageProblem.of(evidence, kernels, car, [loss], evidence.noise())
    theta = {loss.name: loss.start}
    asked = Problem([stage], [loss]).fit(theta, iterations=0).strength
    roll = stage.rollout.vehicle.states.index("roll_dynamics.roll")
    away = []
    for strength in ([1.0], asked):
        fit = Problem([stage], [loss], strength).fit(theta, iterations=8)
        told = stage.at(fit.theta).own_states[roll - len(STATE), evidence.start]
        away.append(np.std(fit.initial[0][roll] - told) / np.std(told))
    assert asked[0] > 100.0
    assert away[1] < 0.1 < 1.0 < away[0]


def test_a_lag_under_another_time_constant_is_that_of_the_same_input(clean):
    evidence = Evidence.of([clean], CHASSIS, 40, 0.5)
    effect = ["vehicle=published", "+vehicle/effect=tyre_heating", "vehicle.effects.tyre_heating.loss=0.0"]

    def heat(time):
        car = CHASSIS.vehicle(make_car(*effect, f"vehicle.effects.tyre_heating.time={time}"))
        return follow(car, evidence)[car.states.index("tyre_heating.heat") - 8]

    slow, quick = heat(30.0), heat(5.0)
    assert np.abs(slow - quick).max() > 0.1
    assert np.allclose(lagged(slow, evidence, 30.0, 5.0), quick, rtol=1e-6, atol=1e-8)
    assert np.allclose(lagged(slow, evidence, 30.0, 30.0), slow, rtol=1e-9, atol=1e-12)


def test_an_actuator_that_was_not_measured_is_led_by_its_command():
    """How fast a servo turns is the same whether its angle was measured or follows from a command, and when."""
    servo = ["+vehicle/effect=steering_second_order", "vehicle.effects.steering_second_order.frequency=15.0"]
    log, vehicle = drive(*servo), make_car("vehicle=published", *servo)
    measured = Evidence.of([log], STEERING, 40, 0.5)
    early = log.table["delta_ref"].shift(-5).ffill()  # 0.05 s
    table = log.table.drop(columns=["delta"]).assign(delta_ref=early)
    stage = dataclasses.replace(CHASSIS, inputs=("delta_ref", "omega"))
    unmeasured = Evidence.of([dataclasses.replace(log, table=table)], stage, 40, 0.5)
    rate = follow(measured.stage.vehicle(vehicle), measured)[-1]
    same, soon = (follow(stage.vehicle(vehicle), unmeasured, (late, 0.0))[-1] for late in (0.05, 0.0))
    assert np.std(same - rate) < 0.2 * np.std(rate) < np.std(soon - rate)


def test_states_are_led_by_the_whole_log(clean):
    evidence = Evidence.of([clean], CHASSIS, 40, 0.5)
    car = CHASSIS.vehicle(make_car("vehicle=published", "+vehicle/effect=[friction_fade,tyre_heating,tyre_relaxation]"))
    own = dict(zip(car.states[8:], follow(car, evidence), strict=True))
    t = evidence.columns["t"]
    assert np.allclose(own["friction_fade.clock"], t - t[0], atol=0.02)
    assert own["tyre_heating.heat"].min() >= 0.0 and 0.0 < own["tyre_heating.heat"].max() < 100.0
    assert np.isfinite(own["tyre_relaxation.alpha_f"]).all() and np.abs(own["tyre_relaxation.alpha_f"]).max() > 0.05


@needs_compiler
@pytest.mark.parametrize(
    ("stage", "effect", "names"),
    [
        (CHASSIS, "pose_latency", ("effects.pose_latency.latency", "yaw_inertia")),
        (CHASSIS, "wheel_speed_gain", ("effects.wheel_speed_gain.gain", "rear.p_Kx1")),
        (CHASSIS, "lever_arm", ("effects.lever_arm.forward", "effects.lever_arm.left")),
        (CHASSIS, "tyre_relaxation", ("effects.tyre_relaxation.length", "front.p_Ky1")),
        (STEERING, "steering_second_order", ("effects.steering_second_order.frequency",)),
        (DRIVE, "drive_load_droop", ("effects.drive_load_droop.droop", "drive.time_constant")),
    ],
)
def test_gradients_of_a_stage_are_those_of_its_cost(clean, stage, effect, names):
    """g = ½ ∂cost/∂θ by central differences, with inputs cut anew for every shift."""
    car = make_car("vehicle=published", f"+vehicle/effect={effect}")
    evidence = Evidence.of([clean], stage, 40, 0.8)
    evidence = dataclasses.replace(evidence, start=evidence.start[:60:6], run=evidence.run[:60:6])
    table = {name: float(value) for name, value in values(car).items()}
    unknowns = [Unknown(name, table[name], 1.0, -10.0, 100.0) for name in names]
    sigma = np.full(len(evidence.observed), 0.01)
    kernels = StageKernels(evidence, make_car("vehicle=published"), names, dict(car.effects))
    problem = StageProblem.of(evidence, kernels, car, unknowns, sigma)
    assert set(problem.names) == set(names)

    def parts(theta):
        windows = problem.windows(theta)
        return problem.rollout.accumulate(problem.parameters(theta), windows), windows

    at, windows = parts(table)
    assert isinstance(windows, Windows)
    g = problem.mixing.T @ at.g[:, : len(problem.rollout.names)].sum(axis=0)
    for name, got in zip(problem.names, g, strict=True):
        # a shift's slope is a smoothed one, and its own difference quotient spans half a sample
        step = 2e-3 if name.endswith("latency") else 1e-5 * max(1.0, abs(table[name]))
        up, down = (parts({**table, name: table[name] + side * step})[0].squares.sum() for side in (1, -1))
        assert got == pytest.approx((up - down) / (4 * step), rel=0.15 if name.endswith("latency") else 1e-3)


@needs_compiler
@pytest.mark.slow
def test_all_effects_in_one_kernel_make_it_few_times_slower(clean):
    """A loop of more than a thousand operands is vectorised, too: it was eight times slower, and is twice."""
    car = make_car("vehicle=published")
    car = dataclasses.replace(car, effects={shape.name: shape.neutral(car) for shape in SHAPES})
    every = {name: starts(name, conf_folder() / "vehicle" / "effect")[0] for name in catalogue.names()}
    evidence = Evidence.of([clean], CHASSIS, 85, 0.8)
    free = [name for name, value in values(car).items() if value != 0.0 or name.startswith("effects.")]
    kernels, seconds = StageKernels(evidence, car, free, every), {}
    table = {name: float(value) for name, value in values(car).items()}
    unknowns = [Unknown(name, table[name], 1.0, -np.inf, np.inf) for name in free]
    for whole in (False, True):
        problem = StageProblem.of(evidence, kernels, car, unknowns, np.full(6, 0.01), whole=whole)
        work = StageFit(problem, {name: table[name] for name in problem.names}, np.arange(64))
        taken = []
        for _ in range(4):
            began = time.process_time()
            work.linearise({name: table[name] for name in problem.names})
            taken.append(time.process_time() - began)
        seconds[whole] = min(taken)
    assert seconds[True] < 4.0 * seconds[False]


@needs_compiler
def test_an_effect_that_does_not_act_in_a_stage_is_not_in_its_kernel(clean):
    car, plain = make_car("+vehicle/effect=[steering_second_order,aero_drag]"), make_car()
    evidence = Evidence.of([clean], DRIVE, 40, 0.8)
    kernels = StageKernels(evidence, plain, ["drive.time_constant"], car.effects)
    assert kernels.choose(car) is kernels.choose(plain)
    chassis = StageKernels(Evidence.of([clean], CHASSIS, 40, 0.8), plain, [], car.effects)
    assert set(chassis.choose(car).catalogue) == {"aero_drag"}
    # states of its own are nobody's there, and the stage's fit is the one without the effect
    unknowns, sigma = [Unknown("drive.time_constant", 0.05, 1.0, 0.001, 1.0)], np.full(len(evidence.observed), 0.01)
    fits = [
        Problem([StageProblem.of(evidence, kernels, each, unknowns, sigma)], unknowns).fit(
            {"drive.time_constant": 0.05}
        )
        for each in (plain, car)
    ]
    assert fits[0].theta == fits[1].theta and np.array_equal(fits[0].cost[0], fits[1].cost[0])


def inertia_problem(log):
    """Return a fit of the chassis with one unknown, the yaw inertia."""
    evidence, car = Evidence.of([log], CHASSIS, 40, 0.8), make_car("vehicle=published")
    unknowns = [Unknown("yaw_inertia", float(car.yaw_inertia), 1.0, 0.01, 1.0)]
    kernels = StageKernels(evidence, car, ["yaw_inertia"], {})
    sigma = np.maximum(evidence.noise(), 1e-3)
    return Problem([StageProblem.of(evidence, kernels, car, unknowns, sigma)], unknowns)


def test_windows_that_no_vehicle_foresees_do_not_decide(clean, monkeypatch):
    """A heading that is late in a few turns must not move the inertia; in plain least squares it does."""
    table = clean.table.copy()
    heading, rate = (table[name].to_numpy().copy() for name in ("yaw", "yaw_rate"))
    for row in np.argsort(-np.abs(np.gradient(rate)))[:2000:400]:
        table.loc[table.index[row - 20 : row + 60], "yaw"] = heading[row - 40 : row + 40]
    spoilt = inertia_problem(dataclasses.replace(clean, table=table))
    truth = inertia_problem(clean).fit({"yaw_inertia": 0.1}).theta["yaw_inertia"]
    robust = spoilt.fit({"yaw_inertia": 0.1}).theta["yaw_inertia"]
    monkeypatch.setattr("racerl.gap.normal_equations.usual_cost", lambda evidence, cost: 1e12)
    plain = spoilt.fit({"yaw_inertia": 0.1}).theta["yaw_inertia"]
    assert abs(robust - truth) < 0.3 * abs(plain - truth) and abs(plain - truth) > 0.01 * truth


def test_the_loss_counts_usual_windows_by_their_cost_and_others_by_its_root():
    usual, step = 100.0, 1e-3
    for cost in (0.5 * usual, usual, 30.0 * usual):
        up, down = (pseudo_huber(np.array([cost + way * step]), usual) for way in (1.0, -1.0))
        assert (up - down) / (2.0 * step) == pytest.approx(slope(np.array([cost]), usual), rel=1e-6)
    assert slope(np.array([usual]), usual) == pytest.approx(1.0) and pseudo_huber(np.zeros(1), usual) == 0.0
    far, farther = pseudo_huber(np.array([1e8, 4e8]), usual)
    assert farther == pytest.approx(2.0 * far, rel=1e-2)


def test_steps_that_do_not_help_cost_no_gradients(clean, monkeypatch):
    investigation = investigate(clean, "yaw_damping")
    counts = {"linearise": 0, "losses": 0}
    for name, whole in (("linearise", StageFit.linearise), ("losses", StageFit.losses)):

        def counted(work, *asked, name=name, whole=whole):
            counts[name] += 1
            return whole(work, *asked)

        monkeypatch.setattr(StageFit, name, counted)
    far = replace_values(investigation.vehicle, {"yaw_inertia": 0.05, "front.p_Ky1": 3.0, "rear.p_Ky1": 1.0})
    before, after = (
        sum(fit_model(investigation, frozenset(), far, None, n, stages=["chassis"]).cost["chassis"]) for n in (0, 6)
    )
    assert after < 0.5 * before
    assert counts["linearise"] == 1 + 1 + 6 < counts["losses"]


def test_every_window_begins_where_it_fits_best(clean):
    (stage,) = inertia_problem(clean).stages
    work = StageFit(stage, {"yaw_inertia": 0.1}, None)
    good, bad = work.initial.copy(), work.initial.copy()
    good[4, ::2] += 3.0  # v_y of every other window
    bad[4, 1::2] += 3.0
    costs = []
    for initial in (good, bad):
        work.initial = initial
        costs.append(work.cost({"yaw_inertia": 0.1}))
    work.begin({"yaw_inertia": 0.1}, good, bad)
    np.testing.assert_allclose(work.cost({"yaw_inertia": 0.1}), np.minimum(*costs))
    before = work.linearise({"yaw_inertia": 0.1}).cost
    alone = StageFit(dataclasses.replace(stage, names=()), {}, None)
    alone.initial = work.initial.copy()
    after = alone.settled()
    assert (after <= before * (1.0 + 1e-9)).all() and after.sum() < 0.8 * before.sum()


def test_a_window_that_its_step_does_not_help_takes_another_or_stays(clean, monkeypatch):
    (stage,) = inertia_problem(clean).stages
    work = StageFit(stage.at({}), {}, None)
    work.remembers = True
    right = work.initial.copy()
    work.initial[4, ::3] -= 3.0  # v_y of a third of the windows, which only the most damped step mends
    work.initial[4, 1::3] += 1.0  # and of another third, which the first one does
    kept, steps = work.initial, {0.5: -1.0, WAYS[0]: 5.0, WAYS[1]: 7.0, WAYS[2]: 3.0}
    lateral = np.arange(len(kept))[:, None] == 4
    monkeypatch.setattr(work, "spread", lambda line, moved, damping: np.where(lateral, steps[damping], 0.0))
    cost = work.move({}, work.linearise({}), np.zeros(1), 0.5)
    assert (kept != right).any(axis=0).mean() > 0.6
    np.testing.assert_allclose(work.initial, right, atol=1e-12)
    np.testing.assert_allclose(cost, work.cost({}), rtol=1e-12)


def test_a_window_whose_cost_falls_goes_on_unasked_and_others_where_they_fit_better(clean, monkeypatch):
    (stage,) = inertia_problem(clean).stages
    work = StageFit(stage.at({}), {}, None)
    work.remembers = True
    kept, line = work.initial.copy(), work.linearise({})
    lateral = np.arange(len(kept))[:, None] == 4
    monkeypatch.setattr(work, "spread", lambda line, moved, damping: np.where(lateral, 1.0, 0.0))
    before = line.cost.copy()
    before[::3], before[1::3] = 1e12, np.inf  # these fall whatever they do; of those nobody knows
    work.move({}, dataclasses.replace(line, cost=before), np.zeros(1), 0.5)
    gone = (work.initial != kept).any(axis=0)
    assert gone[::3].all() and not gone[1::3].any() and not gone[2::3].any()


@pytest.mark.parametrize("rough", [True, False])
def test_a_place_costs_what_its_windows_cost_there_and_earlier_ones_stay_as_they_are(rough, clean):
    problem = inertia_problem(clean)
    (stage,) = problem.stages
    work = StageFit(stage, {"yaw_inertia": 0.1}, None)
    work.remembers = rough
    landscape = Landscape(problem, [work])
    place = Place(np.array([0.1]), [work.initial], [])
    began, at = work.initial.copy(), landscape.linearise(place)
    for damping in (1e-3, 10.0):
        trial = landscape.step(place, at, damping)
        there = work.losses(work.cost(landscape.put(trial))) + problem.prior(trial.theta)
        assert landscape.cost(trial) == pytest.approx(there, rel=1e-12) and there < at.cost
        np.testing.assert_array_equal(place.initial[0], began)


def test_an_absent_effect_changes_nothing_and_a_present_one_all(clean):
    catalogue = {name: make_car(f"+vehicle/effect={name}").effects[name] for name in ("aero_drag", "tyre_relaxation")}
    plain = make_car("vehicle=published")
    dragged = dataclasses.replace(plain, effects={"aero_drag": catalogue["aero_drag"]})
    state, command = random_states(plain, 50)
    full = torch.cat([state, torch.zeros(2, 50, dtype=torch.float64)])
    for car in (plain, dragged):
        got = with_all(car, catalogue).derivative(full, command, TORCH)[:8]
        assert torch.allclose(got, car.derivative(state, command, TORCH), rtol=1e-12, atol=1e-12)


@needs_compiler
def test_the_refit_reaches_the_noise_from_a_vehicle_that_is_off(clean):
    right, priors = configured()
    unknowns = choose_unknowns(right, priors, [], right)
    off = 1.5 * unknowns.sigma * np.random.default_rng(3).uniform(-1.0, 1.0, len(unknowns.names))
    theta = unknowns.clip(unknowns.start + off)
    found = investigate(clean, vehicle=replace_values(right, dict(zip(unknowns.names, theta.tolist(), strict=True))))
    assert beyond(found, found.base, ["chassis"]) < 1.01  # from there alone it would end 6 % above the noise


@needs_compiler
def test_a_displaced_centre_of_gravity_is_known_no_better_than_it_was_weighed():
    ahead = drive(f"+vehicle/effect={COG}", f"vehicle.effects.{COG}.offset=0.03")
    investigation = investigate(ahead, COG)
    found = add(investigation, investigation.base, COG, screen(investigation, investigation.base, COG).vehicle)
    weighed = next(unknown.sigma for unknown in investigation.unknowns if unknown.name == "l_f")
    assert found.theta[f"effects.{COG}.offset"] == pytest.approx(0.03, abs=0.002)
    assert weighed < deviations(investigation, found)[f"effects.{COG}.offset"] < 1.5 * weighed


@needs_compiler
def test_a_displaced_centre_of_gravity_joins_a_vehicle_as_it_was_weighed(clean):
    investigation = investigate(clean, COG, "yaw_damping")
    moved = replace_values(investigation.vehicle, {"l_f": investigation.vehicle.l_f + 0.01})
    for name, l_f in ((COG, investigation.vehicle.l_f), ("yaw_damping", moved.l_f)):
        assert joined(investigation, moved, name, investigation.catalogue[name][0]).l_f == l_f


@needs_compiler
def test_what_the_data_do_not_tell_is_known_as_before(clean):
    base = investigate(clean).base
    problem, blocks = base.problem, [np.arange(len(cost)) for cost in base.cost.values()]
    H, _ = problem._total(base.fit.reduced())
    told = np.diag(H) * problem.scale**2
    sigma = np.array([unknown.sigma for unknown in problem.unknowns])
    known = np.sqrt(np.diag(problem.covariance(base.fit, blocks))) / sigma
    assert (told < 0.05).any() and known[told < 0.05] == pytest.approx(1.0, abs=0.05)
    assert known[problem.names.index("yaw_inertia")] < 0.05


def test_intervals_reach_a_truth_that_the_prior_did_not_expect():
    """A prior eight deviations off draws the fit back by more than its noise, at any strength."""
    inside, pulled = [], []
    for seed, strength in [(seed, strength) for seed in range(40) for strength in (1.0, 9.0)]:
        dice = np.random.default_rng(seed)
        J, truth = dice.standard_normal((24, 5, 3)), np.array([1.0, -2.0, 0.5])
        y = J @ truth + np.sqrt(strength) * dice.standard_normal((24, 5))  # λ is what the model leaves
        unknowns = [Unknown(name, mean, 1.0, -99.0, 99.0) for name, mean in zip("abc", truth - 8.0, strict=True)]
        problem = Problem([SimpleNamespace(names=["a", "b", "c"])], unknowns, [strength])
        H = np.einsum("wni,wnj->wij", J, J)
        total = H.sum(axis=0) + strength * np.eye(3)
        theta = np.linalg.solve(total, np.einsum("wni,wn->i", J, y) + strength * (truth - 8.0))
        slope = np.einsum("wni,wn->wi", J, J @ theta - y)
        fit = SimpleNamespace(theta=problem.named(theta), reduced=lambda H=H, slope=slope: [(H, slope)])
        deviations = np.sqrt(np.diag(problem.covariance(fit, [np.arange(24)])))
        inside.append(np.abs(theta - truth) < 1.96 * deviations)
        pulled.append(truth - theta)
    assert np.mean(pulled) > 0.2 and 0.9 < np.mean(inside) < 1.0


def test_what_one_block_tells_is_known_no_better_than_its_own_noise():
    """The fit follows a block that alone tells of a parameter: its gradient is small, and says nothing of its error."""
    inside = []
    for seed in range(60):
        dice = np.random.default_rng(seed)
        J = dice.standard_normal((24, 5, 2))
        J[1:, :, 1] *= 0.02
        y = dice.standard_normal((24, 5)) + 2.0 * dice.standard_normal((24, 1)) * J[:, :, 1]  # errors hang together
        problem = Problem([SimpleNamespace(names=["a", "b"])], [Unknown(n, 0.0, 9.0, -99.0, 99.0) for n in "ab"])
        H = np.einsum("wni,wnj->wij", J, J)
        theta = np.linalg.solve(H.sum(axis=0) + np.eye(2) / 81.0, np.einsum("wni,wn->i", J, y))
        slope = np.einsum("wni,wn->wi", J, J @ theta - y)
        fit = SimpleNamespace(theta=problem.named(theta), reduced=lambda H=H, slope=slope: [(H, slope)])
        inside.append(np.abs(theta) < 1.96 * np.sqrt(np.diag(problem.covariance(fit, [np.arange(24)]))))
    assert (np.mean(inside, axis=0) > 0.75).all()


@needs_compiler
@pytest.mark.slow
def test_a_hidden_effect_is_named_and_measured(damped):
    decision = name_effects(investigate(damped, "yaw_damping", "aero_drag", "steering_delay", "wheel_speed_gain"))
    assert decision.chosen == ["yaw_damping"]
    assert decision.found.theta["effects.yaw_damping.coefficient"] == pytest.approx(0.15, rel=0.1)
    assert decision.excess[-1] < 0.2 * decision.excess[0]


def test_a_kernel_that_threads_ask_for_at_once_is_made_once(clean, monkeypatch):
    car = make_car("+vehicle/effect=[aero_drag,downforce]")
    kernels, made = StageKernels(Evidence.of([clean], CHASSIS, 40, 0.8), make_car(), [], car.effects), []

    def make(effects):
        time.sleep(0.05)
        made.append(set(effects))
        return object()

    monkeypatch.setattr(kernels, "_make", make)
    with ThreadPoolExecutor(4) as pool:
        shown = list(pool.map(kernels.choose, [car] * 4))
    assert len(set(map(id, shown))) == 1 and made == [set(car.effects)]


@needs_compiler
@pytest.mark.slow
def test_candidates_in_several_threads_are_those_in_one(damped):
    names = ["yaw_damping", "tyre_relaxation", "tyre_heating", "lever_arm"]
    investigation, shown = investigate(damped, *names), []
    base = investigation.base
    alone = [screen(investigation, base, name) for name in names]
    tried = investigation.workers.each(
        lambda name: screen(investigation, base, name), names, lambda name, share: shown.append((name, share))
    )
    assert investigation.workers.threads == 2 and [each.name for each in tried] == names
    assert [each.gain for each in tried] == [each.gain for each in alone] and alone[0].gain > 0.0
    assert [each.vehicle for each in tried] == [each.vehicle for each in alone]
    assert shown == list(zip(names, (0.25, 0.5, 0.75, 1.0), strict=True))


@needs_compiler
def test_an_effect_starts_as_it_was_fitted_before_too(damped, monkeypatch):
    investigation = investigate(damped, "yaw_damping")
    fitted = dataclasses.replace(investigation.catalogue["yaw_damping"][0], coefficient=0.123)
    tried = []

    def record(investigation, base, name, vehicle, stages):
        tried.append(vehicle.effects[name])
        return Screened(name, vehicle, 0.0, "chassis")

    monkeypatch.setattr(screening, "_try", record)
    screen(investigation, investigation.base, "yaw_damping", [fitted])
    assert set(investigation.catalogue["yaw_damping"]) | {fitted} <= set(tried)


@needs_compiler
@pytest.mark.slow
def test_a_small_effect_beside_a_large_one_is_named(monkeypatch):
    monkeypatch.setattr("racerl.gap.comparison.WORTH", 0.06)
    log = drive(
        "+vehicle/effect=[steering_offset,steering_gain]",
        "vehicle.effects.steering_offset.offset=0.08",
        "vehicle.effects.steering_gain.gain=0.92",
        seconds=90.0,
    )
    decision = name_effects(investigate(log, "steering_offset", "steering_gain", "steering_saturation"))
    assert decision.chosen == ["steering_offset", "steering_gain"] and decision.rounds[1][0].worth < 0.06
    assert decision.found.theta["effects.steering_gain.gain"] == pytest.approx(0.92, abs=0.01)


@pytest.mark.slow
@needs_compiler
def test_a_name_behind_which_more_is_missing_that_is_nothing_known_is_none(monkeypatch):
    words = ["+vehicle/effect=[yaw_damping,viscous_drag]", "vehicle.effects.viscous_drag.coefficient=8.0"]
    investigation = investigate(drive(*words), "yaw_damping", "viscous_drag")
    answers = iter([False, True])
    monkeypatch.setattr("racerl.gap.naming.in_doubt", lambda *_: next(answers))
    decision = name_effects(investigation)
    assert sorted([*decision.chosen, decision.doubted]) == ["viscous_drag", "yaw_damping"]
    monkeypatch.setattr("racerl.gap.verdict.LEFT", 0.99)
    monkeypatch.setattr("racerl.gap.verdict.CREDIBLE", 0.01)
    assert judge(investigation, decision).kind == "unknown"
    assert judge(investigation, dataclasses.replace(decision, doubted="")).kind == "named"


@needs_compiler
@pytest.mark.slow
def test_what_is_left_by_a_name_is_excused_only_where_sensors_were_filtered(monkeypatch):
    words = ["+vehicle/effect=[steering_offset,viscous_drag]", "vehicle.effects.viscous_drag.coefficient=8.0"]
    log = drive(*words, seconds=90.0)
    investigation = investigate(log, "viscous_drag")
    decision = name_effects(investigation)
    monkeypatch.setattr("racerl.gap.verdict.COARSE", 0.1)
    assert decision.chosen == ["viscous_drag"] and judge(investigation, decision).kind == "unknown"
    monkeypatch.setattr(Evidence, "filtered", True)
    assert judge(investigation, decision).kind == "named"


@needs_compiler
def test_nothing_is_named_on_a_clean_log(clean):
    assert name_effects(investigate(clean, "yaw_damping", "aero_drag", "steering_delay")).chosen == []


@needs_compiler
def test_one_pass_over_the_catalogue_puts_the_hidden_effect_first(damped):
    names = ("yaw_damping", "locked_differential", "steering_gain", "aero_drag", "pose_latency", "steering_delay")
    investigation = investigate(damped, *names)
    score = summed(scores(investigation, investigation.base).values())
    gains = score.gains()
    assert max(gains, key=gains.get) == "yaw_damping" and gains["yaw_damping"] > 1.2 * gains["locked_differential"]
    assert gains["steering_delay"] < 50.0  # a χ² of one degree of freedom, on residuals that are not quite white
    cosines = score.cosines()
    assert np.allclose(np.diag(cosines), 1.0) and np.abs(cosines).max() <= 1.0 + 1e-9
    damping, spool, delay = (
        score.names.index(name) for name in ("yaw_damping", "locked_differential", "steering_delay")
    )
    assert abs(cosines[damping, spool]) > 0.5 and abs(cosines[damping, delay]) < 0.05


@needs_compiler
@pytest.mark.slow
def test_the_score_takes_priors_as_strong_as_the_fit(damped):
    """What the vehicle's own parameters cannot take up for strong priors counts for an effect."""
    investigation = investigate(damped, "locked_differential")
    base = investigation.base
    around = [dataclasses.replace(u, start=base.theta[u.name]) for u in investigation.unknowns]

    def gain(strength, unknowns):
        like = dataclasses.replace(base, strength={**base.strength, "chassis": strength})
        found = scores(dataclasses.replace(investigation, unknowns=unknowns), like)
        return found["chassis"].gains()["locked_differential"]

    loose, fit, tight = (gain(strength, around) for strength in (1.0, base.strength["chassis"], 1e9))
    assert base.strength["chassis"] > 2.0 and len({round(each, 6) for each in (loose, fit, tight)}) == 3
    assert tight == pytest.approx(gain(1.0, []), rel=1e-2)
    assert scores(investigation, base)["chassis"].gains()["locked_differential"] == gain(
        base.strength["chassis"], investigation.unknowns
    )
