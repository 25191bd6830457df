"""racerl gap from a log to a verdict, a vehicle and a page; and what its steps are made of."""

import dataclasses
import itertools
import shutil
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from scipy.stats import false_discovery_control

from racerl.config import compose_settings
from racerl.documents import read_json
from racerl.errors import ConfigError, LogError, RunError
from racerl.estimation.unknowns import Unknown
from racerl.gap import candidates, diagnose, elimination
from racerl.gap.catalogue import neutral
from racerl.gap.comparison import CandidateScore, Judge, Standing, close, equals
from racerl.gap.decision import Decision, changed, passes_less_noise
from racerl.gap.diagnose import _untestable, gap, next_manoeuvre
from racerl.gap.elimination import _idle, _nowhere, eliminated, settled
from racerl.gap.evidence import Evidence, contradictory
from racerl.gap.growth import growth, places
from racerl.gap.kinematics import consistency
from racerl.gap.locate import BINS, RATE, _test
from racerl.gap.plan import plan, telling
from racerl.gap.prove import explained
from racerl.gap.score import Score, summed
from racerl.gap.screening import Screened, hopeful, scores
from racerl.gap.stage import stages
from racerl.gap.uncertainty import EXACT, FORM, TIMING, intervals
from racerl.gap.verdict import Verdict, _unsettled, judge, open_stage, proved, separable
from racerl.gap.workers import Workers
from racerl.report.gap_page import draw_gap
from racerl.vehicle import catalogue
from racerl.vehicle.cars import read_cars
from racerl.vehicle.load import load_vehicle
from racerl.vehicle.ops import TORCH
from tests.gap.conftest import drive, investigate, settings_for
from tests.vehicle.conftest import make_car

needs_compiler = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler on this machine")
KNOWN = ("yaw_damping", "aero_drag", "command_timestamp_offset", "pose_latency", "lateral_load_sensitivity")
FIELDS = {"verdict", "effects", "ambiguous_with", "next_manoeuvre", "ranking", "where", "gap"}  # of the contract


@pytest.fixture(scope="session")
def diagnosis(damped, tmp_path_factory):
    folder = tmp_path_factory.mktemp("gap")
    settings = settings_for(damped, folder, *KNOWN)
    heard = []
    facts = gap(settings, folder / "out", lambda what, share: heard.append((what, share)))
    return SimpleNamespace(facts=facts, out=folder / "out", settings=settings, heard=heard)


@needs_compiler
def test_the_hidden_effect_is_named_with_its_interval_and_the_gap_closes(diagnosis):
    facts = diagnosis.facts
    assert set(facts) >= FIELDS and facts == read_json(diagnosis.out / "verdict.json")
    assert facts["verdict"] == "named" and not facts["ambiguous_with"] and not facts["next_manoeuvre"]
    (effect,) = facts["effects"]
    coefficient = effect["parameters"]["coefficient"]
    low, high = coefficient["ci95"]
    assert effect["name"] == "yaw_damping" and coefficient["unit"] == "N m s"
    assert coefficient["value"] == pytest.approx(0.15, rel=0.05) and 0.0 < low < 0.15 < high < low + 0.04
    assert facts["ranking"][0]["name"] == "yaw_damping" and facts["ranking"][0]["p"] < 0.01
    assert facts["gap"]["unfitted"] > facts["gap"]["before"] > 1.1 > facts["gap"]["after"] > 0.9
    low, high = facts["gap"]["ci95"]
    assert 0.8 < low <= facts["gap"]["explained"] <= high <= 1.0
    channels = facts["gap"]["by_channel"]
    assert set(channels) == {"delta", "omega", "x", "y", "yaw"} and not facts["worse"]
    assert channels["yaw"]["after"] < 0.8 * channels["yaw"]["before"]
    assert {clue["stage"] for clue in facts["where"]} <= {"chassis"}
    shares = [share for _, share in diagnosis.heard]
    assert shares == sorted(shares) and shares[0] >= 0.0 and shares[-1] < 1.0


@needs_compiler
def test_the_vehicle_file_holds_the_effect_and_is_one_that_every_command_takes(diagnosis):
    car = load_vehicle({"file": str(diagnosis.out / "model.yaml")})
    assert set(car.effects) == {"yaw_damping"}
    assert float(car.effects["yaw_damping"].coefficient) == pytest.approx(0.15, rel=0.1)
    assert float(car.yaw_inertia) == pytest.approx(
        float(load_vehicle(diagnosis.settings["vehicle"]).yaw_inertia), rel=0.05
    )
    coefficients = read_cars(diagnosis.out, car)["effects.yaw_damping.coefficient"]
    low, high = diagnosis.facts["effects"][0]["parameters"]["coefficient"]["ci95"]
    assert np.quantile(coefficients, [0.025, 0.975]) == pytest.approx([low, high], rel=0.05)


@needs_compiler
def test_a_consistent_log_is_found_consistent_and_the_chain_adds_up(diagnosis):
    located = read_json(diagnosis.out / "locate.json")
    rows = {row["what"].split(",")[0].split(" by ")[0]: row for row in located["kinematics"]}
    for what in ("displacement", "turning"):
        assert 0.5 * rows[what]["expected"] < rows[what]["value"] < 1.5 * rows[what]["expected"], what
    assert rows["wheel speed over speed on straights"]["value"] == pytest.approx(1.0, abs=0.02)
    assert 0.0 < rows["yaw rate behind the steering angle"]["value"] < 0.15
    chain, links = located["chain"], located["stages"]["chassis"]
    assert chain["channels"] == links["channels"]
    late, floor = (np.array(chain[key]["85"]) for key in ("errors", "floor"))
    assert (late > 0.5 * floor).all() and (late > 1.5 * floor).any()  # the damping is not in the vehicle yet


@needs_compiler
def test_the_page_shows_verdict_and_pictures(diagnosis):
    page = draw_gap(diagnosis.out).read_text()
    assert "The whole chain" in page and "Kinematic consistency" in page
    assert "yaw_damping" in page and page.count("</figure>") in (4, 5)
    with pytest.raises(RunError, match="choose another out="):
        gap(diagnosis.settings, diagnosis.out)


@needs_compiler
def test_the_worst_stretch_and_the_path_are_those_of_the_log(diagnosis, damped):
    proof = read_json(diagnosis.out / "prove.json")
    stretch, path, table = proof["stretch"], proof["path"], damped.table
    assert stretch["stage"] == "chassis" and 1 <= len(stretch["windows"]) <= 4  # there the damping is
    times = [window["t"] for window in stretch["windows"]]
    assert all(a[-1] == pytest.approx(b[0]) for a, b in itertools.pairwise(times))  # side by side
    errors = {"before": [], "after": []}
    for window in stretch["windows"]:
        rows = np.searchsorted(table["t"] - table["t"][0], np.array(window["t"]) - 1e-6)
        for c, channel in enumerate(stretch["channels"]):
            shown = np.unwrap(table[channel]) if channel == "yaw" else table[channel].to_numpy()
            assert window["measured"][c] == pytest.approx(shown[rows])
            for kind, found in errors.items():
                found.append(np.mean((np.subtract(window[kind][c], window["measured"][c]) / stretch["noise"][c]) ** 2))
    assert np.mean(errors["before"]) > 1.5 * np.mean(errors["after"])
    windows = diagnosis.facts["gap"]["before"], diagnosis.facts["gap"]["after"]
    for kind, told in zip(("before", "after"), windows, strict=True):
        assert np.sqrt(np.mean([row[kind] ** 2 for row in path])) == pytest.approx(told, rel=0.5)
    assert max(row["before"] for row in path) > 1.5 * np.median([row["before"] for row in path])
    ends = [(row["x"][-1], row["y"][-1]) for row in path[:1]] + [(path[1]["x"][0], path[1]["y"][0])]
    assert ends[0] == pytest.approx(ends[1], abs=2e-3)  # windows follow each other


def _learned(car, log):
    """Return the yaw acceleration that effects add along a log, (T,)."""
    plain = dataclasses.replace(car, effects={})
    rows = [log.table[name].to_numpy(copy=True) for name in plain.states]
    state = torch.tensor(np.stack(rows + [0.0 * rows[0]] * (len(car.states) - len(rows))))
    command = torch.tensor(log.table[["delta_ref", "omega_ref"]].to_numpy(copy=True).T)
    at = plain.states.index("yaw_rate")
    return (
        car.derivative(state, command, TORCH)[at] - plain.derivative(state[: len(rows)], command, TORCH)[at]
    ).numpy()


@needs_compiler
@pytest.mark.slow
@pytest.mark.parametrize("learns", [False, True])
def test_what_no_known_effect_explains_is_called_unknown_and_gets_no_name(damped, tmp_path, monkeypatch, learns):
    if not learns:
        monkeypatch.setattr(diagnose, "_residual", lambda *given: None)
    facts = gap(settings_for(damped, tmp_path, "aero_drag", "lateral_load_sensitivity"), tmp_path / "out")
    assert facts["verdict"] == "unknown" and facts["effects"] == []
    assert not load_vehicle({"file": str(tmp_path / "out" / "model.yaml")}).effects
    if not learns:
        return
    # what is offered has no physical name, helps, and is a vehicle that every command takes
    assert 0.4 < facts["residual"]["explained"] <= 1.0
    car = load_vehicle({"file": str(tmp_path / "out" / "model_residual.yaml")})
    assert set(car.effects) == set(facts["residual"]["name"].split(" + "))
    # terms that the data do not ask for are gone; what is left turns against the yaw rate, like the hidden damping
    assert len(facts["residual"]["terms"]) < 25
    assert np.corrcoef(_learned(car, damped), damped.table["yaw_rate"])[0, 1] < -0.9
    assert "learned residual" in draw_gap(tmp_path / "out").read_text()


@needs_compiler
@pytest.mark.slow
@pytest.mark.parametrize(("late", "name"), [(4, "pose_latency"), (-4, "command_timestamp_offset")])
def test_one_shift_has_the_name_of_what_is_late(clean, tmp_path, late, name):
    motion, table = ["x", "y", "yaw", "v_x", "v_y", "yaw_rate"], clean.table.copy()
    table[motion] = table.groupby("run")[motion].shift(late)  # 10 ms each
    shifted = dataclasses.replace(clean, name="shifted", table=table.dropna().reset_index(drop=True))
    facts = gap(settings_for(shifted, tmp_path, *KNOWN), tmp_path / "out")
    assert facts["verdict"] == "named" and facts["effects"][0]["name"] == name, facts["reason"]
    assert facts["effects"][0]["parameters"]["latency"]["value"] == pytest.approx(0.04, abs=0.002)


@pytest.mark.slow
@needs_compiler
def test_what_cannot_be_told_apart_is_called_ambiguous(tmp_path):
    """Where no command is logged, an angle that is wrong on the road and one that is measured wrong are the same."""
    log = drive("+vehicle/effect=steering_offset", "vehicle.effects.steering_offset.offset=0.03")
    blind = dataclasses.replace(log, table=log.table.drop(columns="delta_ref"))
    names = {"steering_offset", "steering_sensor_offset"}
    facts = gap(settings_for(blind, tmp_path, "yaw_damping", *names), tmp_path / "out")
    assert facts["verdict"] == "ambiguous", facts["reason"]
    assert {facts["effects"][0]["name"], *facts["ambiguous_with"]} == names
    assert "delta_ref in the log" in facts["next_manoeuvre"]
    (offset,) = facts["effects"][0]["parameters"].values()
    assert abs(offset["value"]) == pytest.approx(0.03, abs=0.003)


@needs_compiler
def test_a_clean_log_gets_no_name(clean, tmp_path):
    facts = gap(settings_for(clean, tmp_path, *KNOWN), tmp_path / "out")
    assert facts["verdict"] in ("none", "under_excited") and facts["effects"] == [] and not facts["worse"]
    assert facts["gap"]["before"] == pytest.approx(1.0, abs=0.15) and facts["gap"]["explained"] < 0.5


@pytest.fixture
def parked(clean):
    still = clean.table.assign(v_x=0.0, omega=0.0, delta=0.0, x=1.0, y=1.0, yaw=0.0)
    return dataclasses.replace(clean, name="parked", table=still[still["t"] - still["t"].min() < 10.0])


def test_a_log_without_driving_gives_no_guess(parked, tmp_path):
    facts = gap(settings_for(parked, tmp_path), tmp_path / "out")
    assert facts["verdict"] == "under_excited" and facts["effects"] == [] and "circles" in facts["next_manoeuvre"]
    assert load_vehicle({"file": str(tmp_path / "out" / "model.yaml")}).effects == {}
    assert "under excited" in draw_gap(tmp_path / "out").read_text()
    with pytest.raises(LogError, match=r"20 stretches of 85 samples above 0\.5 m/s"):
        plan(settings_for(parked, tmp_path), tmp_path / "plan", compose_settings)


def test_a_log_that_is_given_twice_counts_once(parked, tmp_path):
    settings = settings_for(parked, tmp_path)
    settings |= {"logs": 2 * settings["logs"]}
    facts = gap(settings, tmp_path / "out")
    assert len(facts["logs"]) == 1 and "are copies of others and were left out" in facts["remarks"][0]
    with pytest.raises(LogError, match=r"^[^,]*: 10\.0 s; 20 stretches"):
        plan(settings, tmp_path / "plan", compose_settings)


@needs_compiler
def test_without_a_log_the_plan_is_that_of_the_programme(tmp_path, monkeypatch):
    monkeypatch.setattr("racerl.gap.plan.SECONDS", 90)
    known = ("yaw_damping", "aero_drag", "viscous_drag")
    without = [name for name in catalogue.names() if name not in known]
    settings = {**compose_settings("gap", ["logs=[]", "vehicle=published"]), "without": without}
    facts = plan(settings, tmp_path / "out", compose_settings)
    assert facts["logs"][0]["seconds"] == pytest.approx(90, abs=10) and set(facts["effects"]) == set(known)
    assert all(effect["shows"] for effect in facts["effects"].values())
    cosines = np.abs(np.array(facts["cosines"]))
    damping, aero, viscous = (list(facts["effects"]).index(name) for name in known)
    assert cosines[aero, viscous] > 0.8 > cosines[damping, aero]
    assert read_json(tmp_path / "out" / "plan.json") == facts


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"window": 5}, "window = 5"),
        ({"folds": True}, "folds = True"),
        ({"slowest": -1.0}, "slowest"),
        ({"without": ["steering_dely"]}, "did you mean steering_delay"),
        ({"without": None}, "without = None: a list of effects"),
        ({"hold": 3}, "hold = 3: a list of parameters"),
    ],
)
def test_settings_out_of_range_are_refused_before_anything_is_written(clean, tmp_path, changes, message):
    with pytest.raises(ConfigError, match=message):
        gap(settings_for(clean, tmp_path, **changes), tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("stage", [gap, lambda settings, out: plan(settings, out, compose_settings)])
def test_logs_of_other_sample_times_are_refused_before_anything_is_written(clean, tmp_path, stage):
    coarse = dataclasses.replace(clean, name="coarse", table=clean.table[::2])
    logs = [str(path) for log in (clean, coarse) for path in settings_for(log, tmp_path)["logs"]]
    with pytest.raises(LogError, match=r"0\.01 s apart, coarse.*: 0\.02 s; give data\.resample"):
        stage({**settings_for(clean, tmp_path), "logs": logs}, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_where_an_actuator_was_not_measured_its_command_drives():
    everything = {"delta", "omega", "delta_ref", "omega_ref", "v_x"}
    assert stages(everything)[2].inputs == ("delta", "omega")
    assert stages(everything - {"delta"})[2].inputs == ("delta_ref", "omega")
    assert stages(everything - {"omega"})[2].inputs == ("delta", "omega_ref")


def test_velocities_that_lag_their_poses_stand_alone(clean):
    generator, table = np.random.default_rng(0), clean.table.copy()
    for name in ("v_x", "v_y", "yaw_rate"):
        table[name] += 0.01 * generator.standard_normal(len(table))
    measured = dataclasses.replace(clean, table=table)
    late = table.copy()
    for name in ("v_x", "v_y", "yaw_rate"):
        late[name] = late.groupby("run")[name].shift(7).fillna(0.0)
    lagging = dataclasses.replace(clean, table=late)
    assert contradictory([lagging]) and not contradictory([measured])
    chassis = stages(clean.channels)[2]
    assert Evidence.of([lagging], chassis, 40, 0.5).observed == ("v_x", "v_y", "yaw_rate")


@pytest.mark.parametrize("still", ["delta", "yaw_rate"])
def test_what_never_changes_has_no_lag(clean, still):
    chassis = stages(clean.channels)[2]

    def compared(log):
        return [row["what"] for row in consistency(Evidence.of([log], chassis, 85, 0.5))]

    assert "yaw rate behind the steering angle" in compared(clean)
    slow = clean.table["v_x"] < 0.8  # what it does where it hardly moves tells nothing
    log = dataclasses.replace(clean, table=clean.table.assign(**{still: np.where(slow, clean.table[still], 0.1)}))
    assert "yaw rate behind the steering angle" not in compared(log)


def test_noise_alone_does_not_grow():
    errors = np.random.default_rng(0).standard_normal((86, 2, 2000)) * np.array([[0.1], [3.0]])
    assert growth(errors, np.array([0.1, 3.0])).mean(axis=0) == pytest.approx([1.0, 1.0], rel=0.03)


def test_a_map_is_clear_only_where_power_follows_the_condition():
    generator = np.random.default_rng(0)
    bins = np.repeat(generator.permutation(np.repeat(np.arange(6), 40)), 5)
    chances = []
    for _ in range(40):
        chances.append(_test(generator.chisquare(1, 1200), generator.permutation(bins))[1])
    assert 0.2 < np.mean(chances) < 0.8 and min(chances) > 0.001
    level, p = _test(generator.chisquare(1, 1200) * (1.0 + 2.0 * (bins == 4)), bins)
    assert p < 0.01 and int(np.argmax(level)) == 4


def test_one_clear_map_among_a_hundred_is_found():
    """With few rolls no map could pass a false-discovery rate of 5 % over all of them."""
    generator = np.random.default_rng(0)
    bins = np.repeat(generator.integers(BINS, size=1200), 5)
    power = generator.chisquare(1, len(bins))
    others = [_test(power, generator.permutation(bins))[1] for _ in range(103)]
    adjusted = false_discovery_control([_test(power * (1.0 + (bins == 4)), bins)[1], *others])
    assert adjusted[0] < RATE and np.mean(adjusted[1:] > RATE) > 0.95


def test_places_are_where_errors_grow(clean):
    evidence = Evidence.of([clean], stages(clean.channels)[2], 85, 0.5)
    errors = 0.01 * np.random.default_rng(0).standard_normal((86, 3, len(evidence.start)))
    middle = evidence.start[len(evidence.start) // 2] + 42
    x, y = (evidence.columns[axis][middle] for axis in ("x", "y"))
    rows = evidence.start + np.arange(86)[:, None]
    near = np.hypot(evidence.columns["x"][rows] - x, evidence.columns["y"][rows] - y) < 1.0
    errors[:, 2] += 0.2 * np.cumsum(near, axis=0) / 10.0
    ((a, b),) = places(evidence, errors, np.full(3, 0.01), 1.5, 1)
    assert np.hypot(a - x, b - y) < 1.0
    several = places(evidence, errors, np.full(3, 0.01), 1.5, 1000)  # more than there is room for
    assert several[0] == (a, b) and 1 < len(several) < 50


def test_rivals_explain_as_much_for_their_parameters():
    def row(name, behind, share, size, clear=True):
        return SimpleNamespace(name=name, behind=behind, explained=share, size=size, clear=clear)

    best = row("best", 0.0, 0.95, 1)
    others = [
        row("equal", 1.0, 0.94, 1),
        row("far", 9.0, 0.94, 1),
        row("faint", 1.0, 0.94, 1, clear=False),
        row("less", 1.0, 0.80, 1),
        row("larger", 1.0, 0.955, 3),
        row("larger and better", -0.5, 0.94, 3),
    ]
    assert [other.name for other in equals([best, *others])] == ["equal", "larger and better"]


@pytest.mark.parametrize(
    ("shares", "chosen", "rivals"),
    [
        ({"vl": 0.97, "al": 0.60, "l": 0.2}, "vl", []),  # alike at first, told apart once the other one is in
        ({"vl": 0.97, "al": 0.96, "l": 0.2}, "vl", ["a"]),
        ({"vl": 0.80, "al": 0.99, "l": 0.2, "a": 0.5}, "al", []),
        ({"vl": 0.80, "al": 0.99, "l": 0.2, "a": 0.99}, "a", []),  # the other one mended what the wrong one left
        ({"vl": 0.97, "al": 0.60, "l": 0.97}, "l", []),
    ],
)
def test_effects_are_judged_again_beside_those_found_after_them(monkeypatch, shares, chosen, rivals):
    monkeypatch.setattr("racerl.gap.decision.excess", lambda *_: 0.0)
    monkeypatch.setattr(elimination, "passes_less_noise", lambda *_: False)

    def fit(names):
        left = {"chassis": 1.0 - {"": 0.0, **shares}["".join(name for name in "val" if name in names)]}
        vehicle = SimpleNamespace(effects=dict.fromkeys(names))
        return SimpleNamespace(names=frozenset(names), vehicle=vehicle, cost=left)

    def score(name, found, standing):
        part = 1.0 - found.cost["chassis"] / standing.cost["chassis"]
        row = {
            "explained": part,
            "gain": part,
            "needed": False,
            "stays": part > 0.04,
            "clear": True,
            "size": 1,
            "behind": 0.0,
        }
        return SimpleNamespace(name=name, found=found, cost=found.cost, **row)

    def ranked(rows, cost):
        rows = sorted(rows, key=lambda row: -row.explained)
        for row in rows:
            row.behind = 20.0 * (rows[0].explained - row.explained)
        return rows

    investigation = SimpleNamespace(workers=Workers(), floor={"chassis": 0.0}, seed=0)
    monkeypatch.setattr("racerl.gap.decision.noise_cost", lambda *_: {"chassis": 0.0})
    monkeypatch.setattr("racerl.gap.decision.held_out", lambda investigation, found: found.cost)
    monkeypatch.setattr("racerl.gap.decision.converged", lambda investigation, found: found)
    monkeypatch.setattr("racerl.gap.decision.better_half_way", lambda investigation, found: found)
    monkeypatch.setattr(elimination, "without", lambda investigation, found, name: fit(found.names - {name}))
    monkeypatch.setattr(elimination, "joined", lambda *_: None)
    monkeypatch.setattr(elimination, "add", lambda investigation, base, name, vehicle: fit(base.names | {name}))
    judge = SimpleNamespace(investigation=investigation, score=score, ranked=ranked, one=lambda *_: False)
    v, a, both = (SimpleNamespace(cost={"chassis": left}, vehicle=fit("vl").vehicle) for left in (0.22, 0.23, 0.03))
    a.vehicle = SimpleNamespace(effects={"a": None})
    before = Standing(None, {"chassis": 1.0}, {})
    first = {
        "v": ranked([score("v", v, before), score("a", a, before)], {}),
        "l": [score("l", both, before)],
    }
    decision = eliminated(judge, Decision(fit("vl"), fit("vl").cost, {"chassis": 0.0}, None, first, None))
    assert decision.chosen == list(chosen) and decision.found.names == set(chosen)
    assert decision.cost == fit(chosen).cost
    assert [other.name for other in equals(decision.kept[chosen[0]])] == rivals


def test_the_least_cost_of_noise_is_the_noise(monkeypatch):
    monkeypatch.setattr("racerl.gap.decision.excess", lambda *_: 0.0)
    monkeypatch.setattr("racerl.gap.decision.held_out", lambda *_: {})
    monkeypatch.setattr("racerl.gap.decision.noise_cost", lambda investigation, found, seed: found)
    investigation = SimpleNamespace(floor={"drive": 5.0, "chassis": 9.0}, seed=0)
    for passed, least in ((7.0, 7.0), (11.0, 9.0)):
        decision = changed(investigation, Decision(None, {}, {}, None, {}, None), {}, {"chassis": passed})
        assert decision.noise == {"drive": 5.0, "chassis": least}
    doubting = Decision(None, {}, {}, None, {}, None, doubted="roll_dynamics")
    assert changed(investigation, doubting, {}, {"chassis": 7.0}).doubted == ""  # it was beside other effects


def test_what_nobody_would_miss_would_not_show():
    names, H = ["yaw_damping", "aero_drag", "roll_dynamics"], np.diag([900.0, 900.0, 10.0])
    chassis = Score(names, H, np.zeros(3), np.array([800.0, 1000.0, 0.0]))
    assert Score(names, H, np.zeros(3)).hidden() == ("roll_dynamics",)  # less than chance may give
    assert chassis.hidden() == ("aero_drag", "roll_dynamics")
    drive = Score(["aero_drag"], np.array([[300.0]]), np.zeros(1), np.array([100.0]))
    assert summed([chassis, drive]).hidden() == ("roll_dynamics",)  # 1200 of 1100 over both stages
    twins = Score(names[:2], np.full((2, 2), 900.0), np.zeros(2), np.full(2, 1000.0))
    assert twins.hidden() == tuple(names[:2]) and twins.one(*names[:2])


@pytest.mark.slow
def test_an_effect_shows_from_the_share_of_the_noise_that_a_name_must_take(damped):
    investigation = investigate(damped, "yaw_damping", "tyre_heating")
    found = scores(investigation, investigation.base)["chassis"]
    noise, power = investigation.floor["chassis"], dict(zip(found.names, np.diag(found.H), strict=True))
    assert 30.0 < power["tyre_heating"] < 0.01 * noise < power["yaw_damping"]  # in a minute
    assert found.hidden() == ("tyre_heating",)


def test_the_share_explained_stays_inside_its_bounds():
    assert explained(10.0, 4.0, 2.0) == pytest.approx(0.75)
    assert explained(10.0, 1.0, 2.0) == 1.0 and explained(10.0, 12.0, 2.0) == 0.0 and explained(2.0, 1.0, 2.0) == 0.0


def test_a_plan_asks_for_what_is_dark_and_for_what_looks_alike():
    names = ["aero_drag", "viscous_drag", "friction_fade", "steering_delay"]
    H = np.diag([900.0, 900.0, 1.0, 400.0])
    H[0, 1] = H[1, 0] = 0.97 * 900.0
    told = telling(Score(names, H, np.zeros(4)))
    assert [row["effects"] for row in told["alike"]] == [["aero_drag", "viscous_drag"]]
    assert [name for name, effect in told["effects"].items() if not effect["shows"]] == ["friction_fade"]
    wanted = {name for row in told["next"] for name in row["for"]}
    assert wanted == {"aero_drag", "viscous_drag", "friction_fade"}


def test_what_shows_and_looks_like_no_other_is_separable():
    names = ["aero_drag", "viscous_drag", "friction_fade", "steering_delay", "downforce"]
    H = np.diag([900.0, 900.0, 1.0, 400.0, 400.0])
    H[0, 1] = H[1, 0] = -0.97 * 900.0
    H[2, 3] = H[3, 2] = 0.97 * 20.0  # what does not show stands in nobody's way
    H[3, 4] = H[4, 3] = 0.9 * 400.0
    assert separable(Score(names, H, np.zeros(5))) == ("steering_delay", "downforce")


@pytest.mark.parametrize(
    ("name", "values", "key", "deviation"),
    [
        ("steering_gain", {"gain": 1.1}, "gain", EXACT * 0.1),  # of what it changes, not of the gain
        ("steering_backlash", {"play": 0.04}, "play", FORM * 0.04),
        ("tyre_heating", {"loss": 0.1, "time": 20.0}, "time", FORM * 20.0),
        ("friction_patch", {"depth": 0.3, "x": 12.0, "radius": 1.5}, "x", FORM * 1.5),  # the world's origin is anywhere
        ("learned_residual", {"about_turn": 0.5}, "about_turn", 0.0),
        ("steering_delay", {"delay": 0.03}, "delay", np.hypot(EXACT * 0.03, TIMING * 0.02)),  # of the slowest log
        ("lever_arm", {"forward": 0.1}, "forward", EXACT * 0.1),
    ],
)
def test_an_effect_is_known_no_better_than_its_form(name, values, key, deviation, monkeypatch):
    vehicle = dataclasses.replace(make_car(), effects={name: catalogue.entry(name).cls(**values)})
    parameter, value = f"effects.{name}.{key}", values[key]
    unknowns = [Unknown(parameter, 0.0, 1.0, -100.0, 100.0)]
    found = SimpleNamespace(vehicle=vehicle, theta={parameter: value}, problem=SimpleNamespace(unknowns=unknowns))
    monkeypatch.setattr("racerl.gap.uncertainty.deviations", lambda *_: {parameter: 0.0})
    stages = {name: SimpleNamespace(dt=dt) for name, dt in (("steering", 0.01), ("chassis", 0.02))}
    _, low, high = intervals(SimpleNamespace(evidence=stages), found)[parameter]
    assert 0.5 * (high - low) == pytest.approx(1.96 * deviation) and 0.5 * (low + high) == pytest.approx(value)


def test_nor_is_a_number_of_the_vehicle_known_to_any_digit(monkeypatch):
    unknowns = [Unknown("yaw_inertia", 0.14, 1.0, 0.0, 1.0)]
    found = SimpleNamespace(vehicle=make_car(), theta={"yaw_inertia": 0.14}, problem=SimpleNamespace(unknowns=unknowns))
    monkeypatch.setattr("racerl.gap.uncertainty.deviations", lambda *_: {"yaw_inertia": 0.001})
    _, low, high = intervals(SimpleNamespace(evidence={"chassis": SimpleNamespace(dt=0.01)}), found)["yaw_inertia"]
    assert 0.5 * (high - low) == pytest.approx(1.96 * np.hypot(0.001, EXACT * 0.14))


@pytest.mark.parametrize(
    ("noise", "cost", "less"),
    [
        (990.0, 100.0, False),
        (900.0, 100.0, True),
        (900.0, 10_000.0, False),  # where a fit is lost, that much noise hardly counts
        (1100.0, 100.0, False),
    ],
)
def test_a_gain_that_is_noise_passed_on_no_longer_is_none(monkeypatch, noise, cost, less):
    """Ten windows at the cost of a usual one, where half of the noise's cost is in the loss."""
    monkeypatch.setattr("racerl.gap.comparison.wild", lambda *_: 30.0 * 100.0)
    monkeypatch.setattr("racerl.gap.decision.noise_cost", lambda *_: {"chassis": noise})
    judge = Judge(SimpleNamespace(seed=0), {})
    decision = SimpleNamespace(cost={"chassis": np.full(10, cost)}, noise={"chassis": 1000.0})
    best = SimpleNamespace(found=None, gain=55.0, error=5.0)
    assert passes_less_noise(judge, decision, best) == less


def test_rolls_are_counted_as_if_each_was_carried_out():
    generator = np.random.default_rng(0)
    for dependent in (0.0, 0.5, 3.0):
        bins = np.repeat(generator.integers(BINS, size=60), 5)
        power = generator.exponential(size=300) + dependent * (bins == 2)

        def spread(power, bins=bins):
            means = [power[bins == b].mean() for b in range(BINS)]
            return sum((bins == b).sum() * (m - power.mean()) ** 2 for b, m in enumerate(means))

        expected = np.mean([spread(np.roll(power, s)) >= spread(power) * (1 - 1e-9) for s in range(300)])
        level, p = _test(power, bins)
        assert p == pytest.approx(expected) and level[2] == pytest.approx(power[bins == 2].mean())


def test_a_rear_driven_split_is_no_idle_effect():
    assert _idle("steering_offset", {"effects.steering_offset.offset": (0.001, -0.001, 0.003)})
    assert not _idle("steering_offset", {"effects.steering_offset.offset": (0.003, 0.001, 0.005)})
    assert not _idle("drive_split", {"effects.drive_split.front": (0.0, 0.0, 0.1)})  # bounds, not doubt
    ahead, aside = ((0.0005, -0.001, 0.002), (0.005, 0.004, 0.006))  # a point beside the car, neither ahead nor behind
    assert not _idle("lever_arm", {"effects.lever_arm.forward": ahead, "effects.lever_arm.left": aside})
    assert _idle("lever_arm", {"effects.lever_arm.forward": ahead, "effects.lever_arm.left": ahead})


def test_a_limit_that_may_as_well_be_infinite_is_idle():
    assert not _idle("current_limit", {"effects.current_limit.limit": (12.0, 10.8, 13.2)})
    assert _idle("current_limit", {"effects.current_limit.limit": (70.0, 0.5, 150.0)})
    assert _idle("steering_saturation", {"effects.steering_saturation.limit": (0.9, 0.75, 1.0)})  # its bound
    known, unknown = (20.0, 18.0, 22.0), (20.0, 1.0, 50.0)  # of two, one that is known is enough
    for stall, top in ((known, unknown), (unknown, known), (known, known)):
        assert not _idle("back_emf", {"effects.back_emf.stall": stall, "effects.back_emf.top_speed": top})
    assert _idle("back_emf", {"effects.back_emf.stall": unknown, "effects.back_emf.top_speed": unknown})


def test_what_has_limits_says_which():
    for name in catalogue.names():
        entry = catalogue.entry(name)
        assert set(entry.cls.unbounded) <= set(entry.parameters)
        first, zero = neutral(name)
        if entry.cls.vanishing and not entry.cls.unbounded:  # or no interval could ever hold "no effect"
            assert entry.parameters[first].low <= zero <= entry.parameters[first].high, name


def test_a_place_anywhere_on_the_floor_is_none():
    evidence = {"chassis": SimpleNamespace(columns={"x": np.array([-3.0, 4.0]), "y": np.array([0.0, 5.0])})}

    def ranges(name, x, y):
        return {f"effects.{name}.{axis}": (1.0, 1.0 - half, 1.0 + half) for axis, half in (("x", x), ("y", y))}

    assert not _nowhere("road_bank", ranges("road_bank", 1.0, 2.0), evidence)
    assert _nowhere("road_bank", ranges("road_bank", 1.0, 2.6), evidence)
    assert _nowhere("friction_patch", ranges("friction_patch", 9.0, 0.1), evidence)
    assert not _nowhere("yaw_damping", {}, evidence) and not _nowhere(
        "road_slope", {}, evidence
    )  # nowhere in particular


def test_what_has_a_place_needs_a_pose():
    without = _untestable({}, {"v_x", "v_y", "yaw_rate", "delta", "omega"})
    assert (
        without.keys() >= {"road_bank", "road_slope", "friction_patch", "pose_latency"}
        and "x, y, yaw" in without["road_bank"]
    )
    assert not without.keys() & {"friction_fade", "tyre_heating", "yaw_damping", "lever_arm"}
    assert "road_bank" not in _untestable({}, {"x", "y", "yaw", "delta", "omega"})


def test_what_a_stage_lacks_is_told():
    without = _untestable({}, {"v_x", "yaw_rate", "delta_ref", "omega_ref"})
    assert without["steering"].startswith("needs delta_ref and delta over")  # no wheel speed
    assert "one of x, y, yaw, v_x, v_y, yaw_rate" in without["chassis"]


def test_the_next_manoeuvre_is_what_would_decide():
    open_question = Verdict("ambiguous", ("steering_delay",), ("steering_second_order",), (), "")
    assert "step" in next_manoeuvre(open_question)
    assert next_manoeuvre(Verdict("named", ("steering_delay",), (), (), "")) == ""


@pytest.mark.parametrize(
    ("chosen", "excess", "kind"),
    [
        (["aero_drag"], [1000.0, 20.0], "named"),
        (["aero_drag"], [1000.0, 540.0], "under_excited"),  # the little that is there is mostly something else
        (["aero_drag"], [9e6, 5e6], "named"),  # a real car, sensors that were filtered: noise is no yardstick
        (["aero_drag"], [5e6, 9e6], "unknown"),  # nor is a name one that explains nothing
        ([], [100.0], "none"),
    ],
)
def test_a_name_must_explain_most_of_a_small_excess(monkeypatch, chosen, excess, kind):
    monkeypatch.setattr("racerl.gap.verdict.open_stage", lambda *_: ("", 0.0, 0.0))
    before, after = ({"chassis": each, "steering": 800.0} for each in (excess[0], excess[-1]))  # steering's is chance
    monkeypatch.setattr("racerl.gap.verdict.fitted", lambda *_: (before, after))
    evidence = {"chassis": SimpleNamespace(filtered=True)}
    monkeypatch.setattr("racerl.gap.verdict.touched", lambda *_: ["chassis"])
    investigation = SimpleNamespace(evidence=evidence, shaped=False, shapes=[])
    score = Score(["aero_drag", "downforce"], np.diag([900.0, 900.0]), np.zeros(2))
    found = SimpleNamespace(vehicle=None)
    noise = {"chassis": 1e5, "steering": 1e4}
    decision = SimpleNamespace(chosen=chosen, kept={}, found=found, noise=noise, score=score, doubted="", features=[])
    monkeypatch.setattr("racerl.gap.verdict.unlisted", lambda *_: 0.0)
    verdict = judge(investigation, decision)
    assert kind != "under_excited" or verdict.reason == "aero_drag explains only 46% of a small excess"
    assert verdict.kind == kind and verdict.effects == (() if kind in ("under_excited", "none") else ("aero_drag",))
    if kind == "under_excited":  # what a foreign tyre leaves beside a name does not speak against it
        assert judge(SimpleNamespace(evidence=evidence, shaped=True), decision).kind == "named"


def test_a_claim_under_which_the_error_grows_is_none():
    named = Verdict("named", ("wheel_speed_latency",), (), ("downforce",), "")
    assert proved(named, {"before": 26.41, "after": 25.0}) == named
    assert proved(named, {"before": 1.12, "after": 1.21}) == named  # near the noise one fold decides
    grown = proved(named, {"before": 26.41, "after": 32.90})
    assert grown.kind == "unknown" and grown.effects == named.effects and grown.blind == named.blind
    assert "grows from 26.41 to 32.90" in grown.reason
    silent = Verdict("none", (), (), (), "")
    assert proved(silent, {"before": 1.0, "after": 2.0}) == silent


def test_a_small_effect_beside_a_large_one_must_explain_what_is_left_and_not_look_like_it():
    H = np.array([[4.0, -1.8, 0.0], [-1.8, 1.0, 0.0], [0.0, 0.0, 9.0]])
    score = Score(["steering_saturation", "steering_nonlinearity", "aero_drag"], H, np.zeros(3))
    assert score.likeness("steering_nonlinearity", ["steering_saturation"]) == pytest.approx(0.9)
    assert score.likeness("aero_drag", ["steering_saturation"]) == score.likeness("aero_drag", []) == 0.0
    small = CandidateScore("steering_nonlinearity", None, {}, 90.0, 10.0, 0.0, explained=0.9, worth=0.02, before=1.0)
    assert small.needed and not dataclasses.replace(small, like=0.9).needed
    assert dataclasses.replace(small, like=0.9, worth=0.05).needed
    assert not dataclasses.replace(small, explained=0.5).needed
    # most of what is left will do where that is more than a wrong form or another formula leaves
    most = dataclasses.replace(small, explained=0.6)
    assert most.needed and not dataclasses.replace(most, like=0.9).needed
    assert not dataclasses.replace(most, before=0.08).needed and dataclasses.replace(small, before=0.08).needed
    assert not dataclasses.replace(most, foreign=True).needed and dataclasses.replace(small, foreign=True).needed
    assert not dataclasses.replace(small, error=40.0).needed
    # a fit at the noise lacks nothing, whatever its folds cost, unless the gain is beyond doubt
    assert not dataclasses.replace(small, worth=0.05, before=-0.01, error=20.0).needed
    # what came in with three standard errors does not go at a little less
    assert (less := dataclasses.replace(small, error=32.0)).stays and not less.needed
    assert not dataclasses.replace(small, error=50.0).stays and not dataclasses.replace(small, explained=0.5).stays


def test_what_a_foreign_tyre_leaves_is_no_effects():
    found = SimpleNamespace(effects={"aero_drag"})
    some = CandidateScore("aero_drag", found, {}, 90.0, 10.0, 0.0, explained=0.8, worth=0.8, before=0.10, fall=0.08)
    assert some.needed and not dataclasses.replace(some, foreign=True, explained=0.6, worth=0.6).needed
    assert dataclasses.replace(some, foreign=True).needed  # nearly all of it
    assert dataclasses.replace(some, foreign=True, before=0.3, fall=0.2).needed
    assert not dataclasses.replace(some, foreign=True, before=0.3, fall=0.02).needed
    beyond_doubt = dataclasses.replace(some, before=0.02, fall=0.02)
    assert not dataclasses.replace(beyond_doubt, fall=0.006).needed  # nobody misses so little
    assert beyond_doubt.needed and not dataclasses.replace(beyond_doubt, foreign=True).needed


def test_a_name_is_as_stable_as_resamples_of_the_runs_leave_it(monkeypatch):
    """One candidate helps everywhere by 50, another in every second run by more: by how much more decides."""
    monkeypatch.setattr("racerl.gap.comparison.blocks", lambda evidence: {"chassis": np.arange(40)})
    evidence, base = (
        {"chassis": SimpleNamespace(numbers=85, run=np.zeros(40))},
        SimpleNamespace(cost={"chassis": np.full(40, 85.0)}),
    )
    judge = Judge(SimpleNamespace(evidence=evidence, base=base, seed=0), {}, Score([], np.zeros((0, 0)), np.zeros(0)))
    before = {"chassis": np.full(40, 200.0)}

    def leads(name, fall, other):
        rows = [candidate("even", np.full(40, 50.0)), candidate("uneven", np.tile([fall, 0.0], 20)), *other]
        ranked = judge.ranked(rows, before)
        return {row.name: row.leads for row in ranked}[name]

    def candidate(name, fall):
        fit = SimpleNamespace(problem=SimpleNamespace(names=[f"effects.{name}.size"]))
        cost, explained = {"chassis": 200.0 - fall}, float(fall.mean()) / 115.0
        return CandidateScore(name, fit, cost, float(fall.sum()), 1.0, 0.0, explained, explained, 1.0)

    assert leads("even", 30.0, []) == 1.0 and leads("uneven", 30.0, []) == 0.0
    assert 0.2 < leads("even", 100.0, []) < 0.8 and leads("even", 100.0, []) + leads("uneven", 100.0, []) == 1.0
    assert leads("even", 30.0, [candidate("harm", np.full(40, -9.0))]) == 1.0
    # nor does one come first that harms on the whole, though the noise of the difference covers that
    astray = candidate("astray", np.concatenate([np.full(36, -30.0), np.full(4, 180.0)]))
    small = candidate("even", np.full(40, 1.0))
    led = {row.name: row.leads for row in judge.ranked([small, astray], before)}
    assert led["even"] > 0.9


def test_of_effects_that_are_one_the_first_by_name_stands_for_all():
    """Whatever the last digits of their fits say; another that helps as much is not of them."""
    names = ["steering_offset", "steering_sensor_offset", "aero_drag"]
    H = np.array([[90.0, -90.0, 0.0], [-90.0, 90.0, 0.0], [0.0, 0.0, 90.0]])
    evidence = {"chassis": SimpleNamespace(run=np.zeros(40), start=np.arange(40) * 6, length=1, numbers=85)}
    base = SimpleNamespace(cost={"chassis": np.full(40, 85.0)})
    judge = Judge(SimpleNamespace(evidence=evidence, base=base, seed=0), {}, Score(names, H, np.zeros(3)))
    before = {"chassis": np.full(40, 200.0)}

    def row(name, cost, explained):
        fit = SimpleNamespace(problem=SimpleNamespace(names=[f"effects.{name}.size"]))
        return CandidateScore(name, fit, {"chassis": np.full(40, cost)}, 200.0 - cost, 1.0, 0.0, explained, 0.5, 1.0)

    for sensor in (100.0, 101.0, 99.0):
        rows = [
            row("steering_offset", 100.0, 0.5),
            row("steering_sensor_offset", sensor, 0.51),
            row("aero_drag", 130.0, 0.3),
        ]
        ranked = judge.ranked(rows, before)
        assert (
            [each.name for each in ranked[:2]] == names[:2] and ranked[1].behind == 0.0 and close(ranked[1], ranked[0])
        )
        assert ranked[2].behind > 3.0
    # one that is not needed stands for none, whatever its name
    weak = dataclasses.replace(row("steering_offset", 195.0, 0.03), error=5.0)
    assert judge.ranked([weak, row("steering_sensor_offset", 193.0, 0.07)], before)[0].name == "steering_sensor_offset"
    # one that explains far less is no twin: its fit did not end where the other's did
    apart = judge.ranked([row("steering_offset", 150.0, 0.25), row("steering_sensor_offset", 100.0, 0.5)], before)
    assert apart[0].name == "steering_sensor_offset" and apart[1].behind > 3.0


def test_effects_that_are_one_in_a_log_are_rivals(monkeypatch):
    monkeypatch.setattr("racerl.gap.verdict.open_stage", lambda *_: ("", 0.0, 0.0))
    monkeypatch.setattr("racerl.gap.verdict.fitted", lambda *_: ({"chassis": 1e5}, {"chassis": 0.0}))
    H = 900.0 * np.array([[1.0, -0.9999, 0.97], [-0.9999, 1.0, -0.97], [0.97, -0.97, 1.0]])
    score = Score(["steering_offset", "steering_sensor_offset", "camber_thrust"], H, np.zeros(3))
    monkeypatch.setattr("racerl.gap.verdict.touched", lambda *_: ["chassis"])
    rows = [
        SimpleNamespace(name=name, explained=share, behind=behind, clear=True, size=1, leads=1.0)
        for name, share, behind in (("steering_offset", 0.9, 0.0), ("camber_thrust", 0.8, 1.0))
    ]
    twin = SimpleNamespace(name="steering_sensor_offset", explained=0.8, behind=-0.5, clear=True, size=1, leads=0.0)
    for behind, kind in ((-0.5, "ambiguous"), (9.0, "named")):  # its bounds may keep a twin away
        twin.behind = behind
        found = SimpleNamespace(vehicle=None)
        kept = {"steering_offset": [*rows, twin]}
        decision = SimpleNamespace(
            chosen=["steering_offset"], kept=kept, found=found, noise={"chassis": 1e5}, score=score, doubted=""
        )
        verdict = judge(SimpleNamespace(shaped=False), decision)
        said = "steering_offset explains 100% of the excess" + "; steering_sensor_offset explains it as well" * (
            kind == "ambiguous"
        )
        assert verdict.reason == said
        assert verdict.kind == kind and verdict.rivals == (("steering_sensor_offset",) if kind == "ambiguous" else ())


def test_of_many_that_come_out_rarely_the_first_is_the_rival():
    rows = [SimpleNamespace(name=name, leads=lead) for name, lead in zip("abcd", (0.7, 0.06, 0.08, 0.0), strict=True)]
    assert [row.name for row in _unsettled(rows)] == ["c"]
    rows[1].leads = 0.2
    assert [row.name for row in _unsettled(rows)] == ["b"]
    rows[0].leads = 0.8
    assert _unsettled(rows) == [] and _unsettled(rows[:1]) == []


def test_a_name_that_resamples_shake_is_ambiguous_with_what_comes_out_instead(monkeypatch):
    monkeypatch.setattr("racerl.gap.verdict.open_stage", lambda *_: ("", 0.0, 0.0))
    monkeypatch.setattr("racerl.gap.verdict.fitted", lambda *_: ({"chassis": 1e5}, {"chassis": 0.0}))
    monkeypatch.setattr("racerl.gap.verdict.touched", lambda *_: ["chassis"])
    for leads, kind in ((0.85, "named"), (0.75, "ambiguous")):
        rows = [
            SimpleNamespace(name=name, explained=share, behind=behind, clear=True, size=1, leads=lead)
            for name, share, behind, lead in (
                ("steering_offset", 0.9, 0.0, leads),
                ("camber_thrust", 0.8, 1.0, 1.0 - leads),
                ("aero_drag", 0.5, 2.0, 0.01),
            )
        ]
        decision = SimpleNamespace(
            chosen=["steering_offset"],
            kept={"steering_offset": rows},
            found=SimpleNamespace(vehicle=None),
            noise={"chassis": 1e5},
            score=Score([], np.zeros((0, 0)), np.zeros(0)),
            doubted="",
            rounds=[[SimpleNamespace(found=SimpleNamespace(vehicle=None))]],
        )
        verdict = judge(SimpleNamespace(shaped=False), decision)
        assert (verdict.kind, verdict.rivals) == (kind, ("camber_thrust",) if kind == "ambiguous" else ())
        said = "; in 25% of resamples camber_thrust comes first instead"
        assert verdict.reason.endswith(said) == (kind == "ambiguous")
        decision.doubted = "steering_nonlinearity"  # its form is not right, or something else is missing beside it
        verdict = judge(SimpleNamespace(shaped=False), decision)
        assert (verdict.kind, verdict.effects, verdict.rivals) == ("unknown", ("steering_offset",), ())
        told = "missing that resembles steering_nonlinearity but probably is not steering_nonlinearity"
        assert told in verdict.reason


@pytest.mark.parametrize(("left", "kind"), [(0.7e5, "ambiguous"), (0.3e5, "named")])
def test_where_much_stays_what_is_needed_and_close_is_a_rival(left, kind, monkeypatch):
    """Half of a real log named the clock, the other one a servo that the clock was two standard errors behind."""
    monkeypatch.setattr("racerl.gap.verdict.open_stage", lambda *_: ("", 0.0, 0.0))
    monkeypatch.setattr("racerl.gap.verdict.fitted", lambda *_: ({"chassis": 1e5}, {"chassis": left}))
    monkeypatch.setattr("racerl.gap.verdict.touched", lambda *_: ["chassis"])
    monkeypatch.setattr("racerl.gap.verdict._coarse", lambda *_: True)
    rows = [
        SimpleNamespace(name=name, explained=share, behind=behind, clear=True, needed=needed, size=1, leads=1.0)
        for name, share, behind, needed in (
            ("steering_second_order", 0.3, 0.0, True),
            ("tyre_relaxation", 0.2, 2.5, False),
            ("steering_delay", 0.2, 2.0, True),
            ("road_slope", 0.2, 3.5, True),
        )
    ]
    decision = SimpleNamespace(
        chosen=["steering_second_order"],
        kept={"steering_second_order": rows},
        found=SimpleNamespace(vehicle=None),
        noise={"chassis": 1e5},
        score=Score([], np.zeros((0, 0)), np.zeros(0)),
        doubted="",
    )
    verdict = judge(SimpleNamespace(shaped=False), decision)
    assert (verdict.kind, verdict.rivals) == (kind, ("steering_delay",) if kind == "ambiguous" else ())
    said = "steering_delay is only 2.0 standard errors behind, where 70% stays unexplained"
    assert verdict.reason.endswith(said) == (kind == "ambiguous")


def test_what_was_rather_not_added_is_told_where_nothing_was(monkeypatch):
    monkeypatch.setattr("racerl.gap.verdict.unlisted", lambda *_: 0.9)
    monkeypatch.setattr("racerl.gap.verdict.fitted", lambda *_: 2 * ({"chassis": 2e4},))
    investigation = SimpleNamespace(shaped=False, chance={"chassis": 0.005})
    rows = [SimpleNamespace(name="roll_dynamics", explained=0.44, found=SimpleNamespace(vehicle=None))]
    decision = SimpleNamespace(
        chosen=[],
        found=SimpleNamespace(vehicle=None),
        noise={"chassis": 1e5},
        score=Score([], np.zeros((0, 0)), np.zeros(0)),
        doubted="roll_dynamics",
        rounds=[rows],
        features=[],
    )
    for stage, told in (("chassis", True), ("drive", False)):
        monkeypatch.setattr("racerl.gap.verdict.touched", lambda *_, stage=stage: [stage])
        verdict = judge(investigation, decision)
        said = "; roll_dynamics would take 44% of it, but something that is not in the catalogue is more probable"
        assert verdict.kind == "unknown" and verdict.reason.endswith(said) == told


def test_what_would_explain_much_but_not_clearly_is_told(monkeypatch):
    monkeypatch.setattr("racerl.gap.verdict.fitted", lambda *_: 2 * ({"chassis": 8.2e7},))
    row = SimpleNamespace(name="tyre_heating", explained=0.44, gain=28.0, error=10.0, clear=False, found=None)
    row.found = found = SimpleNamespace(vehicle=None)
    score = Score([], np.zeros((0, 0)), np.zeros(0))
    decision = SimpleNamespace(
        chosen=[], found=found, noise={"chassis": 1e5}, score=score, doubted="", rounds=[[row]], features=[]
    )
    monkeypatch.setattr("racerl.gap.verdict.unlisted", lambda *_: 0.9)
    said = "; tyre_heating would take 44% of it, by 2.8 standard errors, and a name takes 3"
    for changes, told in (({}, True), ({"explained": 0.1}, False), ({"gain": -1.0}, False)):
        decision.rounds = [[SimpleNamespace(**{**vars(row), **changes})]]
        monkeypatch.setattr("racerl.gap.verdict.touched", lambda *_: ["chassis"])
        reason = judge(SimpleNamespace(shaped=False, chance={"chassis": 0.005}), decision).reason
        assert reason.startswith("the chassis stage has an excess of 820 times the noise's cost")
        assert reason.endswith(said) == told
    monkeypatch.setattr("racerl.gap.verdict.touched", lambda *_: ["drive"])
    assert said not in judge(SimpleNamespace(shaped=False, chance={"chassis": 0.005}), decision).reason


@pytest.mark.parametrize(
    ("left", "chance", "kind", "said"),
    [
        ({"drive": 2e3, "chassis": 2e4}, 0.4, "none", "excess of 20% over the noise's cost, as clean cars"),
        ({"drive": 2e3, "chassis": 2e4}, 0.6, "unknown", "the chassis stage has an excess of 20%"),
        ({"drive": 8e3, "chassis": 2e4}, 0.4, "unknown", "the drive stage has an excess of 8%"),  # no tyre's, no pose's
        ({"drive": 2e3, "chassis": 8e3}, 0.6, "none", "comes within 10%"),  # whatever the rule says
    ],
)
def test_the_calibrated_rule_tells_a_clean_foreign_car_from_an_unknown_effect(monkeypatch, left, chance, kind, said):
    monkeypatch.setattr("racerl.gap.verdict.fitted", lambda *_: (left, left))
    monkeypatch.setattr("racerl.gap.verdict.unlisted", lambda *_: chance)
    score = Score([], np.zeros((0, 0)), np.zeros(0))
    found = SimpleNamespace(vehicle=None)
    decision = SimpleNamespace(
        chosen=[], found=found, noise=dict.fromkeys(left, 1e5), score=score, doubted="", rounds=[], features=[]
    )
    shapes = ["double_track", "tyre_shape"]
    verdict = judge(SimpleNamespace(shaped=True, shapes=shapes, chance=dict.fromkeys(left, 0.005)), decision)
    assert verdict.kind == kind and said in verdict.reason
    shaped = "with two wheels on an axle and a tyre shape that departs from its formula, "
    assert verdict.reason.startswith(shaped) == (kind == "none")


@pytest.mark.parametrize(
    ("left", "doubted", "kind"),
    [
        ({"drive": 2e3, "chassis": 12e3}, "", "named"),  # a tyre of another formula says nothing against a servo's name
        ({"drive": 2e3, "chassis": 12e3}, "roll_dynamics", "named"),
        ({"drive": 2e3, "chassis": 12e3}, "back_emf", "unknown"),
        ({"drive": 2e5, "chassis": 3e3}, "", "unknown"),
    ],
)
def test_what_is_left_where_an_effect_does_not_act_is_told_beside_its_name(monkeypatch, left, doubted, kind):
    acts = {"current_limit": ["drive"], "back_emf": ["drive"], "roll_dynamics": ["chassis"]}
    monkeypatch.setattr("racerl.gap.verdict.fitted", lambda *_: ({"drive": 4e5, "chassis": 12e3}, left))
    monkeypatch.setattr("racerl.gap.verdict.touched", lambda data, vehicle, names: acts[next(iter(names))])
    evidence = dict.fromkeys(left, SimpleNamespace(filtered=False))
    investigation = SimpleNamespace(shaped=False, chance=dict.fromkeys(left, 0.005), evidence=evidence)
    row = SimpleNamespace(name="current_limit", explained=0.99, behind=0.0, clear=True, size=1, leads=1.0)
    decision = SimpleNamespace(
        chosen=["current_limit"],
        kept={"current_limit": [row]},
        found=SimpleNamespace(vehicle=make_car("+vehicle/effect=current_limit")),
        noise={"drive": 1e5, "chassis": 1e5},
        score=Score([], np.zeros((0, 0)), np.zeros(0)),
        doubted=doubted,
        rounds=[[SimpleNamespace(found=SimpleNamespace(vehicle=None))]],
    )
    verdict = judge(investigation, decision)
    assert (verdict.kind, verdict.effects) == (kind, ("current_limit",))
    told = "in the chassis stage an excess of 12% over the noise's cost stays without a name"
    assert kind == "unknown" or told in verdict.reason


@pytest.mark.parametrize(("needed", "chosen"), [(True, ["road_slope"]), (False, [])])
def test_a_rival_takes_the_place_of_an_effect_that_is_nowhere(monkeypatch, needed, chosen):
    """A bowl whose middle is far off, nobody knows where, is a tilted floor."""

    def fit(*names):
        effects = dict.fromkeys(names)
        return SimpleNamespace(names=set(names), vehicle=SimpleNamespace(effects=effects), cost={"chassis": 0.5})

    def row(name, needed=True, effect=None, leads=1.0):
        facts = {"name": name, "found": fit(effect or name), "cost": {}, "needed": needed, "stays": needed}
        facts |= {"explained": 0.9, "behind": 4.0, "leads": leads}
        return dataclasses.make_dataclass("Row", facts)(**facts)

    def instead(judge, lacking, rival):
        assert rival.name in rival.found.vehicle.effects  # where its fit starts
        return rival

    monkeypatch.setattr("racerl.gap.decision.noise_cost", lambda *_: {"chassis": 0.0})
    monkeypatch.setattr("racerl.gap.decision.held_out", lambda investigation, found: found.cost)
    monkeypatch.setattr("racerl.gap.decision.excess", lambda *_: 0.0)
    monkeypatch.setattr(elimination, "everywhere", lambda investigation, found: found)
    monkeypatch.setattr(elimination, "intervals", lambda investigation, found: {})
    monkeypatch.setattr(elimination, "without", lambda investigation, found, name: fit(*found.names - {name}))
    monkeypatch.setattr(elimination, "_idle", lambda name, ranges: False)
    monkeypatch.setattr(elimination, "_nowhere", lambda name, ranges, evidence: name == "road_bank")
    monkeypatch.setattr(elimination, "_instead", instead)
    told = lambda judge, lacking, rows: {"candidates": [{"name": row.name} for row in rows]}  # noqa: E731
    monkeypatch.setattr(elimination, "features", told)
    monkeypatch.setattr(elimination, "passes_less_noise", lambda *_: False)
    investigation = SimpleNamespace(workers=Workers(), floor={"chassis": 0.0}, seed=0, evidence={}, base=fit())
    judge = SimpleNamespace(
        investigation=investigation, ranked=lambda rows, cost: list(rows), one=lambda row, other: False
    )
    # one with the bowl in this log, it has come to stand beside with the bowl's fit
    kept = {"road_bank": [row("road_bank"), row("road_slope", needed, "road_bank")]}
    rounds = [[row("road_bank"), row("road_slope", needed)]]
    found = fit("road_bank")
    rows = [{"name": name, "leads": 0.5} for name in ("road_bank", "aero_drag", "road_slope")]
    seen = [{"candidates": rows}, {"candidates": rows[1:]}]
    begun = Decision(found, found.cost, {"chassis": 0.0}, None, kept, None, rounds=rounds, features=seen)
    decision = settled(judge, begun)
    if not needed:  # nor does it stand beside one that stays
        three = [row("aero_drag", leads=0.6), row("road_bank", leads=0.25), row("road_slope", leads=0.15)]
        beside = dataclasses.replace(begun, kept={"aero_drag": three}, rounds=[three])
        ended = settled(judge, beside)
        left = ended.kept["aero_drag"]
        assert [each.name for each in left] == ["aero_drag", "road_slope"]
        assert [each.leads for each in left] == pytest.approx([0.8, 0.2])  # of resamples that the bowl did not lead
        assert [row["name"] for row in ended.features[0]["candidates"]] == ["aero_drag", "road_slope"]
        assert [row["leads"] for row in ended.features[0]["candidates"]] == pytest.approx([0.8, 0.2])
        judge.one = lambda row, other: "bank" in other.name  # then the effect has those resamples as well
        assert [each.leads for each in settled(judge, beside).kept["aero_drag"]] == [0.6, 0.15]
    assert decision.chosen == chosen and decision.found.names == set(chosen)
    exchanged = dataclasses.replace(begun, features=seen[1:])  # it came in the place of another
    assert settled(judge, exchanged).features == seen[1:]
    told = [[row["name"] for row in each["candidates"]] for each in decision.features]  # what hypotheses go by
    assert told == ([["road_slope"], ["aero_drag"]] if needed else [["aero_drag", "road_slope"]])


@pytest.mark.parametrize(
    ("kept", "told", "excess"),
    [
        ("abc", ["ar", "br", "cr", "rd"], [9, 4, 2, 1]),
        ("bc", ["br", "cr", "rd"], [9, 2, 1]),  # what the first found went again: the second begins where it did
        ("rbc", ["ra", "b", "c", "d"], [9, 4, 2, 1]),  # or a rival took its place, and is no candidate later
        ("ab", ["ar", "br", "rd"], [9, 4, 2]),
        ("", ["rd"], [9]),
    ],
)
def test_hypotheses_go_by_the_effects_that_are_kept(kept, told, excess):
    seen = [
        {"fit": left, "candidates": [{"name": name} for name in names]}
        for names, left in zip(("ar", "br", "cr", "rd"), (9, 4, 2, 1), strict=True)
    ]
    found = elimination._as_kept(seen, kept)
    assert ["".join(row["name"] for row in each["candidates"]) for each in found] == told
    assert [each["fit"] for each in found] == excess


def test_a_round_that_lost_its_only_candidate_is_left_out():
    rounds = [{"fit": 1, "candidates": [{"name": "a"}]}, {"fit": 1, "candidates": []}, {"fit": 0, "candidates": []}]
    assert [len(each["candidates"]) for each in elimination._as_kept(rounds, ["a"])] == [1, 0]


@pytest.mark.parametrize(
    ("chance", "shaped", "left", "stage"),
    [
        (0.005, False, 8e3, "chassis"),
        (0.02, False, 8e3, ""),
        (0.005, True, 9e3, ""),  # what a foreign tyre may leave
        (0.005, True, 11e3, "chassis"),
    ],
)
def test_an_excess_that_another_drive_might_have_by_chance_is_none(chance, shaped, left, stage):
    investigation = SimpleNamespace(chance={"chassis": chance}, shaped=shaped)
    decision = SimpleNamespace(chosen=[], found=SimpleNamespace(vehicle=make_car()), noise={"chassis": 1e5})
    assert open_stage(investigation, decision, {"chassis": left}, {"chassis": left})[0] == stage


def test_tyres_of_another_formula_leave_nothing_where_there_are_none():
    investigation = SimpleNamespace(chance={"drive": 0.005}, shaped=True)
    decision = SimpleNamespace(chosen=[], found=SimpleNamespace(vehicle=make_car()), noise={"drive": 1e5})
    for left, stage in ((4e3, ""), (8e3, "drive")):
        assert open_stage(investigation, decision, {"drive": left}, {"drive": left})[0] == stage


def test_a_servo_that_explains_little_of_a_small_excess_is_not_excused_by_tyres(monkeypatch):
    monkeypatch.setattr("racerl.gap.verdict.fitted", lambda *_: ({"drive": 1000.0}, {"drive": 540.0}))
    monkeypatch.setattr("racerl.gap.verdict.touched", lambda *_: ["drive"])
    evidence = {"drive": SimpleNamespace(filtered=False)}
    investigation = SimpleNamespace(shaped=True, chance={"drive": 0.005}, evidence=evidence)
    decision = SimpleNamespace(
        chosen=["current_limit"],
        kept={},
        found=SimpleNamespace(vehicle=make_car("+vehicle/effect=current_limit")),
        noise={"drive": 1e5},
        score=Score([], np.zeros((0, 0)), np.zeros(0)),
        doubted="",
    )
    assert judge(investigation, decision).kind == "under_excited"


def test_where_no_effect_acts_nothing_is_excused_by_one(monkeypatch):
    monkeypatch.setattr("racerl.gap.verdict.touched", lambda *_: ["drive"])
    investigation = SimpleNamespace(chance={"chassis": 0.005}, shaped=False, evidence={})
    found = SimpleNamespace(vehicle=make_car("+vehicle/effect=current_limit"))
    decision = SimpleNamespace(chosen=["current_limit"], found=found, noise={"chassis": 1e5})
    excess = {"chassis": 5.4e3}
    assert open_stage(investigation, decision, excess, excess)[0] == "chassis"


@pytest.mark.parametrize(("name", "most"), [("steering_gain", 0.1), ("drive_split", 0.25)])
def test_an_effect_of_one_form_must_leave_less(name, most, monkeypatch):
    evidence = SimpleNamespace(filtered=False)
    monkeypatch.setattr("racerl.gap.verdict.touched", lambda *_: ["chassis"])
    investigation = SimpleNamespace(evidence={"chassis": evidence}, chance={"chassis": 0.01}, shaped=False)
    found = SimpleNamespace(vehicle=make_car(f"+vehicle/effect={name}"))
    decision = SimpleNamespace(chosen=[name], found=found, noise={"chassis": 1e5})
    for share, stage in ((most - 0.02, ""), (most + 0.02, "chassis")):
        assert open_stage(investigation, decision, {"chassis": 1e6}, {"chassis": share * 1e6})[0] == stage


def test_a_candidate_that_a_few_steps_led_astray_is_fitted_where_theory_foretells_a_gain():
    screened = [Screened(n, None, gain, "chassis") for n, gain in (("drag", 900.0), ("roll", -2e3), ("bank", 30.0))]
    score = Score(["roll", "drag", "bank"], np.eye(3), np.sqrt([2e4, 4e3, 5e3]))
    assert [each.name for each in hopeful(screened, score, "chassis")] == ["drag", "roll"]
    assert [each.name for each in hopeful(screened, dataclasses.replace(score, g=np.zeros(3)), "chassis")] == ["drag"]


@pytest.mark.parametrize(("first", "starts"), [(9.0, 1), (12.0, 2)])
def test_a_candidate_whose_fit_went_astray_starts_again_beside_the_fit_before_it(monkeypatch, first, starts):
    tried, costs = [], iter([first, 8.0])

    def fit(investigation, effects, vehicle, base, steps, stages):
        tried.append(vehicle)
        return SimpleNamespace(cost={"chassis": np.array([next(costs)])}, vehicle=vehicle)

    monkeypatch.setattr(candidates, "fit_model", fit)
    monkeypatch.setattr(candidates, "touched", lambda *_: ["chassis"])
    monkeypatch.setattr(
        candidates, "better", lambda investigation, *fits: min(fits, key=lambda one: one.cost["chassis"])
    )
    investigation = SimpleNamespace(cost=lambda found, stage: np.array([10.0]))
    base = SimpleNamespace(effects=frozenset(), vehicle=make_car())
    astray = make_car("vehicle.mass=9.0", "+vehicle/effect=aero_drag")  # where a share of the windows led
    found = candidates.add(investigation, base, "aero_drag", astray)
    assert len(tried) == starts and tried[0] is astray and found.cost["chassis"][0] == {1: 9.0, 2: 8.0}[starts]
    if starts == 2:
        assert found.vehicle.mass == base.vehicle.mass and found.vehicle.effects == astray.effects
