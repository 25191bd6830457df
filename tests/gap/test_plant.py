"""The plant of the blind test is a sound car, its effects are the contract's, and it knows nothing of racerl."""

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest

from tests.gap.plant import cars, effects, families, sensors, tyre
from tests.gap.plant.batch import key, simulate
from tests.gap.plant.car import SLIPS, STRUCTURES, Plant
from tests.gap.plant.cases import SETS, Case, Choice
from tests.gap.plant.effects import CATALOGUE, UNLISTED
from tests.gap.plant.programmes import Run, bowl
from tests.gap.plant.simulate import PREROLL, drive

CATALOGUE_OF_THE_CONTRACT = """
steering_delay steering_second_order steering_rate_limit steering_backlash steering_deadband steering_offset
steering_gain_asymmetry steering_nonlinearity steering_gain steering_saturation steering_compliance
drive_delay drive_brake_asymmetry current_limit back_emf battery_sag drive_load_droop regen_braking drive_split
locked_differential
rolling_resistance viscous_drag aero_drag downforce
longitudinal_load_transfer lateral_load_sensitivity tyre_relaxation friction_fade tyre_heating
speed_dependent_friction friction_patch camber_thrust yaw_damping roll_dynamics
cog_longitudinal_offset cog_lateral_offset road_slope road_bank
pose_latency steering_sensor_latency wheel_speed_latency steering_sensor_offset wheel_speed_gain wheel_growth lever_arm
mocap_yaw_misalignment command_timestamp_offset
"""

SYMMETRIC = [
    "steering_delay",
    "steering_backlash",
    "steering_deadband",
    "locked_differential",
    "tyre_relaxation",
    "roll_dynamics",
    "road_bank",
]


def published(n: int) -> dict[str, np.ndarray]:
    return cars.stack([cars.PUBLISHED] * n)


def medium(name: str) -> dict[str, dict[str, float]]:
    return {name: dict(effects.ALL[name].sizes["medium"])}


def run_of(seconds: float, speed: float, driver, n: int = 1, pose=(0.0, 0.0, 0.0)) -> Run:
    return Run(seconds, np.repeat(np.array(pose)[:, None], n, axis=1), np.full(n, speed), driver)


def held(delta: float, omega: float, n: int = 1):
    return lambda t, state: np.repeat([[delta], [omega]], n, axis=1)


def lively(sign: float, n: int):
    """Steps, a swerve, power and brakes within three seconds."""

    def driver(t: float, state: np.ndarray) -> np.ndarray:
        delta = sign * (0.33 * (0.2 < t < 0.9) - 0.2 * (0.9 < t < 1.4) + 0.1 * np.sin(12 * t) * (t > 1.8))
        omega = 2.5 + 1.8 * (0.5 < t < 1.2) - 1.5 * (t > 1.6) + 2.0 * (t > 2.1)
        return np.repeat([[delta], [omega]], n, axis=1)

    return driver


def log_of(plant: Plant, run: Run) -> dict[str, np.ndarray]:
    return drive(plant, [run])[0][1]


def test_gentle_turn_is_kinematic():
    log = log_of(Plant(published(1)), run_of(1.5, 0.4, held(0.1, 0.4)))
    assert log["yaw_rate"][-1, 0] == pytest.approx(0.4 * np.tan(0.1) / 0.33, rel=0.02)
    assert log["v_y"][-1, 0] == pytest.approx(log["yaw_rate"][-1, 0] * (0.33 - 0.1568), abs=0.01)


def test_straight_line_follows_the_wheels():
    """With steady wheels on a straight the slip carries the drag alone: κ K_x = drag."""
    log = log_of(Plant(published(1)), run_of(1.0, 3.0, held(0.0, 3.0)))
    drag = 8.5e-4 + 5.9e-4 * 3 + 2.8e-4 * 9
    K_x = 5.1 * 9.81 * (1.268 * 0.1732 + 5.848 * 0.1568) / 0.33
    assert log["v_x"][-1, 0] == pytest.approx(3.0 * (1 - drag / K_x), abs=1e-4)
    assert np.abs(log["y"]).max() < 1e-12


def test_locked_wheels_stop_the_car_at_the_limit_of_grip():
    log = log_of(Plant(published(1)), run_of(0.5, 4.0, held(0.0, 0.0)))
    peak = 0.8 * 9.81 * (0.8016 * 0.1732 + 0.8299 * 0.1568) / 0.33
    assert 0.5 * peak < -np.gradient(log["v_x"][:, 0], 0.01)[20] <= 1.02 * peak


def test_tyre_is_odd_and_weakened_by_the_other_slip():
    wheels = Plant(published(1)).wheels
    curves = wheels.tyre.curves(wheels.load, np.full((2, 1), 0.8))
    slip = np.full((2, 2, 1), 0.2)
    both, pure_y = tyre.forces(curves, slip), tyre.forces(curves, slip * [[[0.0]], [[1.0]]])
    assert np.allclose(tyre.forces(curves, -slip), -both)
    assert (both[1] < pure_y[1]).all()
    assert (pure_y[1] < curves.peak[1]).all()


@pytest.mark.parametrize("family", families.FAMILIES)
def test_tyres_of_other_families_share_stiffness_and_peak(family):
    """The same stiffness and peak as the Magic Formula's, and no force beyond the ellipse of the peaks."""
    wheels, forces = Plant(published(1)).wheels, families.forces_of(family)
    curves = wheels.tyre.curves(wheels.load, np.full((2, 1), 0.8))
    one = np.ones((2, 2, 1))
    only_x, only_y = one * [[[1.0]], [[0.0]]], one * [[[0.0]], [[1.0]]]
    slope = (forces(curves, 1e-5 * only_x) + forces(curves, 1e-5 * only_y)) / 1e-5
    magic = (tyre.forces(curves, 1e-5 * only_x) + tyre.forces(curves, 1e-5 * only_y)) / 1e-5
    assert np.allclose(slope, magic, rtol=1e-3)
    slips = np.array([forces(curves, s * only_y)[1] / curves.peak[1] for s in np.linspace(0.0, 8.0, 200)])
    assert slips.max() == pytest.approx(1.0, abs=0.03) and (np.diff(slips[:20], axis=0) > 0.0).all()
    slip = np.random.default_rng(0).uniform(-1.0, 1.0, (500, 2, 2, 1))
    ends = np.array([forces(curves, each) / curves.peak for each in slip])
    assert (np.hypot(ends[:, 0], ends[:, 1]) < 1.03).all()
    assert np.allclose([forces(curves, -each) / curves.peak for each in slip], -ends)


@pytest.mark.slow
def test_cars_on_other_tyres_and_slips_are_other_cars():
    def end(**kind):
        return log_of(Plant(published(1), **kind), run_of(3.0, 2.5, lively(1.0, 1)))["yaw"][-1, 0]

    usual = end()
    others = [end(family=family) for family in families.FAMILIES] + [end(slip="surface"), end(slip="larger")]
    assert min(abs(other - usual) for other in others) > 0.02
    gentle = [log_of(Plant(published(1), slip=slip), run_of(1.0, 1.0, held(0.05, 1.0)))["yaw"][-1, 0] for slip in SLIPS]
    assert gentle == pytest.approx([gentle[0]] * 3, rel=1e-3)  # slips over any speed are alike where they are small


@pytest.mark.slow
def test_sensors_change_what_is_told_of_one_drive():
    """The same car, driving and noise: what the sensors do is of the size that they say, and late in nothing."""
    names = ["ideal", "bent", "coarse", "filtered", "sparse"]
    cases = [SETS["clean"](Choice(seed=3, noises=(1.0,), minutes=0.3, sensors=name))[0] for name in names]
    assert len({case.name for case in cases}) == 5 and len({case.origin for case in cases}) == 1
    ideal, bent, coarse, filtered, sparse = (simulate([case])[0] for case in cases)
    off = bent[["x", "y"]] - ideal[["x", "y"]]
    assert 0.2e-3 < off.to_numpy().std() < 2e-3 and off.diff().abs().to_numpy()[1:].max() < 2e-4
    assert bent.drop(columns=["x", "y"]).equals(ideal.drop(columns=["x", "y"]))
    assert (coarse["omega"] - ideal["omega"]).abs().max() == pytest.approx(0.01, rel=0.01)
    assert (coarse["delta"] - ideal["delta"]).abs().max() == pytest.approx(np.pi / 4096, rel=0.01)
    late = [np.mean(np.diff(ideal["yaw_rate"]) * np.roll(np.diff(filtered["yaw_rate"]), k)) for k in (-1, 0, 1)]
    assert max(late) == late[1] and filtered["v_x"].diff().std() < 0.5 * ideal["v_x"].diff().std()
    assert sparse.equals(ideal.groupby("run").nth(slice(None, None, 2)).reset_index(drop=True))


@pytest.mark.slow
def test_a_smaller_step_changes_how_one_drive_is_integrated_and_nothing_else():
    """Heun's error falls by four where the step is halved."""
    cases = [SETS["clean"](Choice(seed=3, noises=(1e-6,), minutes=0.3, step=step))[0] for step in (1e-3, 5e-4, 2.5e-4)]
    assert len({case.name for case in cases}) == 3 and len({case.origin for case in cases}) == 1
    full, half, quarter = (simulate([case])[0] for case in cases)
    first = full["run"] == full["run"].iloc[0]  # later ones steer by where the car is, and part
    off = [(a["yaw_rate"] - b["yaw_rate"])[first].abs().max() for a, b in ((full, half), (half, quarter))]
    assert 3.0 < off[0] / off[1] < 6.0 and off[0] < 0.01


def test_four_wheels_scrub_where_one_track_does_not():
    """Wheels side by side slip unlike each other in a turn; on a straight they are one."""
    tight = {s: log_of(Plant(published(1), structure=s), run_of(1.5, 1.0, held(0.35, 1.0))) for s in STRUCTURES}
    rates = {s: float(log["yaw_rate"][-1, 0]) for s, log in tight.items()}
    assert 0.002 < abs(rates["four_wheels"] / rates["single_track"] - 1) < 0.1
    assert 0.002 < abs(rates["ackermann"] / rates["four_wheels"] - 1) < 0.1
    straight = [log_of(Plant(published(1), structure=s), run_of(1.0, 2.0, held(0.0, 3.0)))["v_x"] for s in STRUCTURES]
    assert np.allclose(straight[0], straight[1], atol=1e-9)


def test_front_wheels_on_one_circle_do_not_scrub():
    """Where the rear axle rolls about a point, no front wheel slips sideways, and the inner one steers more."""
    plant = Plant(published(1), structure="ackermann")
    wheelbase, ahead = plant.cars["wheelbase"][0], plant.cars["l_f"][0]
    speed, radius = 1.0, 0.8
    plant.state[3], plant.state[4], plant.state[5] = speed, speed / radius * (wheelbase - ahead), speed / radius
    plant.state[6], plant.state[7] = np.arctan(wheelbase / radius), speed
    plant.now.command = plant.state[6:8]
    plant.derivative(0.0, plant.state)
    assert np.abs(plant.now.slip[1]).max() < 1e-9
    assert plant.sin[0, 0] > np.sin(plant.state[6, 0]) > plant.sin[1, 0] > 0.0


@pytest.mark.slow
def test_a_slippery_floor_changes_the_floor_only():
    choice = {"seed": 3, "noises": (1.0,), "programmes": ("circles",)}
    pair = [SETS["clean"](Choice(**choice, floor=floor))[0] for floor in (1.0, 0.5)]
    grip, slick = (case.car() for case in pair)
    assert slick == {**grip, "friction": 0.5 * grip["friction"]} and pair[0].name != pair[1].name
    logs = [simulate([dataclasses.replace(case, minutes=0.4)])[0] for case in pair]
    assert np.array_equal(logs[0]["delta_ref"], logs[1]["delta_ref"])
    ends = [log.groupby("run")["v_x"].max().to_numpy() for log in logs]
    assert len(ends[0]) == 8 and (ends[1] <= ends[0] + 0.1).all()


def test_halving_the_step_changes_little():
    n, names = 4, ["steering_delay", "tyre_relaxation", "drive_split"]
    hidden = [{}, *map(medium, names)]
    ends = [
        log_of(Plant(published(n), effects.build(hidden), dt=dt), run_of(3.0, 2.5, lively(1.0, n), n))
        for dt in (1e-3, 5e-4)
    ]
    for name in sensors.CHANNELS:
        assert np.abs(ends[0][name] - ends[1][name]).max() < 1e-3, name


def test_two_tracks_agree_with_one_when_gentle():
    ends = [log_of(Plant(published(1), structure=s), run_of(1.0, 1.0, held(0.05, 1.0)))
            for s in ("single_track", "two_track")]  # fmt: skip
    assert ends[0]["yaw"][-1] == pytest.approx(ends[1]["yaw"][-1], rel=0.02)


def test_two_tracks_differ_when_pushed():
    ends = [log_of(Plant(published(1), structure=s), run_of(1.2, 3.0, lively(1.0, 1)))
            for s in ("single_track", "two_track")]  # fmt: skip
    assert np.abs(ends[0]["yaw"] - ends[1]["yaw"]).max() > 0.02


def test_names_are_the_contracts():
    assert sorted(CATALOGUE) == sorted(CATALOGUE_OF_THE_CONTRACT.split())
    assert not set(UNLISTED) & set(CATALOGUE)
    assert len(UNLISTED) == 8


@pytest.mark.parametrize("name", effects.ALL)
def test_effects_have_three_sizes_and_units(name):
    kind = effects.ALL[name]
    assert set(kind.sizes) == {"small", "medium", "large"}
    assert all(set(values) == set(kind.units) for values in kind.sizes.values())
    assert set(kind.signed) | set(kind.fixed) <= set(kind.units)


def test_every_effect_shows():
    names = list(effects.ALL)
    n = len(names) + 1
    plant = Plant(published(n), effects.build([{}, *map(medium, names)]), lean=bowl)
    ((_, log),) = _late(plant, run_of(2.2, 2.5, lively(1.0, n), n, pose=(-1.0, 0.5, 0.3)))
    shown = {
        name: max(np.abs(log[c][:, i + 1] - log[c][:, 0]).max() / sensors.NOISE[c] for c in sensors.NOISE)
        for i, name in enumerate(names)
    }
    assert not {name: round(ratio, 2) for name, ratio in shown.items() if ratio < 3}


def _late(plant: Plant, run: Run):
    """Drive long after the log began and with a worn battery, for effects that grow with time."""
    place = plant.place

    def later(pose, speed, t):
        place(pose, speed, t + 120.0)
        for effect in plant.effects:
            if effect.name == "battery_sag":
                plant.state[effect.rows] = 300.0

    plant.place = later
    return drive(plant, [run])


def test_off_means_off():
    """Beside cars with effects, a car without drives exactly as it does alone."""
    names = list(effects.ALL)
    n = len(names) + 1
    crowd = Plant(published(n), effects.build([{}, *map(medium, names)]), lean=bowl)
    run, alone = run_of(0.3, 2.5, lively(1.0, n), n), run_of(0.3, 2.5, lively(1.0, 1))
    both = log_of(crowd, run), log_of(Plant(published(1)), alone)
    for name in sensors.CHANNELS:
        assert np.allclose(both[0][name][:, 0], both[1][name][:, 0], atol=1e-9), name


def test_mirrored_drives_give_mirrored_logs():
    n = len(SYMMETRIC)
    logs = [
        log_of(
            Plant(published(n), effects.build(list(map(medium, SYMMETRIC))), lean=bowl),
            run_of(1.2, 2.5, lively(sign, n), n, pose=(-1.0, sign * 0.5, sign * 0.3)),
        )
        for sign in (1.0, -1.0)
    ]
    signs = {name: -1.0 if name in ("y", "yaw", "v_y", "yaw_rate", "delta", "delta_ref") else 1.0
             for name in sensors.CHANNELS}  # fmt: skip
    for name, sign in signs.items():
        assert np.allclose(logs[0][name], sign * logs[1][name], atol=1e-6), name


@pytest.mark.parametrize("programme", ["short", "still", "race"])
def test_logs_keep_the_contract(programme):
    case = Case("single", (("pose_latency", "medium"), ("wheel_growth", "large")), programme, minutes=0.03)
    (log,) = simulate([case])
    assert tuple(log.columns) == ("t", "run", *sensors.CHANNELS)
    assert np.isfinite(log.to_numpy()).all()
    for _, run in log.groupby("run"):
        assert np.allclose(np.diff(run["t"]), 0.01)
    assert log["t"].is_monotonic_increasing


def test_a_log_does_not_depend_on_its_batch():
    a, b = (Case("clean", (), "short", number=i, minutes=0.02) for i in (1, 2))
    alone, together = simulate([a])[0], simulate([b, a])[1]
    assert np.allclose(alone, together)


def test_differentiated_velocities_resemble_the_measured():
    log = log_of(Plant(published(1)), run_of(2.0, 2.0, lively(1.0, 1)))
    one = {name: values[:, 0] for name, values in log.items()}
    worked_out = sensors.differentiate(one)
    for name in ("v_x", "v_y", "yaw_rate"):
        assert np.abs(worked_out[name] - one[name]).mean() < 0.02, name


def test_late_channels_are_late_exactly():
    late = effects.build([medium("wheel_speed_latency"), {}])
    late[0].p["latency"][:] = 0.03
    log = log_of(Plant(published(2), late), run_of(1.0, 2.5, lively(1.0, 2), 2))
    assert np.allclose(log["omega"][3:, 0], log["omega"][:-3, 1])
    latencies = [kind.sizes["large"].get("latency", 0.0) for kind in CATALOGUE.values()]
    assert max(latencies) < PREROLL


@pytest.mark.parametrize("name", SETS)
def test_designs_are_opaque_and_deterministic(name):
    cases, again = SETS[name](Choice(seed=3)), SETS[name](Choice(seed=3))
    assert [c.name for c in cases] == [c.name for c in again]
    assert len({c.name for c in cases}) == len(cases)
    assert all(re.fullmatch("[0-9a-f]{12}", c.name) for c in cases)
    assert {c.name for c in SETS[name](Choice(seed=4))}.isdisjoint({c.name for c in cases})
    assert key(cases[-1])["set"] == name


def test_there_are_pairs_enough():
    assert len(SETS["pairs"](Choice())) >= 30
    assert len(SETS["single"](Choice())) == len(CATALOGUE) * 3 * 3 * 2


def test_plant_knows_nothing_of_racerl():
    sources = list((Path(__file__).parent / "plant").rglob("*.py"))
    assert len(sources) > 10
    for source in sources:
        for line in source.read_text().splitlines():
            assert not re.match(r"\s*(from|import)\s+racerl", line), source
            imported = re.match(r"(?:from|import)\s+(\w+)", line)
            assert imported is None or imported[1] in ALLOWED, f"{source}: {line}"


ALLOWED = {"__future__", "argparse", "collections", "dataclasses", "hashlib", "itertools", "json", "numpy", "pandas",
           "pathlib", "scipy", "tests", "time", "typing"}  # fmt: skip
