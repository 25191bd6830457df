"""A double track, and tyres of another formula, are shapes of the refit's vehicle, and no effects."""

from dataclasses import replace
from types import SimpleNamespace

import pandas as pd
import pytest

import racerl.gap.naming as naming
import racerl.gap.shapes as shapes
from racerl.data.log import Log
from racerl.gap.diagnose import gap
from racerl.gap.investigation import DOUBLE_TRACK, TYRE_SHAPE
from racerl.gap.naming import name_effects
from racerl.gap.progress import silent
from racerl.gap.screening import screen
from racerl.gap.shapes import LARGE, SHAPES, in_order, said_of, shapes_of
from racerl.gap.verdict import judge
from racerl.gap.workers import Workers
from racerl.vehicle.effects.double_track import DoubleTrack
from racerl.vehicle.effects.tyre_shape import TyreShape
from racerl.vehicle.load import load_vehicle
from racerl.vehicle.parameter import values
from tests.gap.conftest import configured, drive, investigate, settings_for
from tests.gap.plant.__main__ import main as simulate

LARGE_AT = [f"{slip}_{axle}" for slip in ("kappa", "alpha") for axle in "fr"]
WORDS = [f"+vehicle.effects.{TYRE_SHAPE}.{name}=0.1" for name in LARGE_AT]
OTHER = [f"+vehicle.effects.{TYRE_SHAPE}.{name}" for name in ("aside_drive=-0.4", "aside_turn_drive=0.4")]


@pytest.fixture(scope="module")
def foreign():
    """A drive on tyres whose side force falls by 18 % where they are driven, and rises where they brake."""
    return drive(
        *WORDS, f"+vehicle.effects.{TYRE_SHAPE}.aside_drive=-0.4", f"+vehicle.effects.{TYRE_SHAPE}.aside_turn_drive=0.4"
    )


@pytest.mark.slow
def test_a_right_tyre_keeps_its_formula(clean):
    investigation = investigate(clean, "yaw_damping")
    decision = name_effects(investigation)
    assert decision.investigation is investigation and not investigation.shaped


@pytest.mark.slow
def test_a_foreign_tyre_is_a_shape_and_no_effect(foreign):
    plain = investigate(foreign, "yaw_damping", "roll_dynamics")
    decision = name_effects(plain)
    shaped = decision.investigation
    assert decision.chosen == [] and judge(shaped, decision).kind == "none"
    assert shaped.shaped and shapes_of(shaped.base) == [TYRE_SHAPE] and shapes_of(plain.base) == []
    cost = {name: each.base.cost["chassis"].sum() for name, each in (("plain", plain), ("shaped", shaped))}
    assert cost["plain"] > 1.1 * plain.floor["chassis"] and cost["shaped"] < 1.05 * shaped.floor["chassis"]
    # the vehicle as configured is the same, shape or not; slips count as large in proportion to its own
    assert replace(shaped.vehicle, effects={}) == plain.vehicle
    table = values(shaped.vehicle)
    for axle in ("front", "rear"):
        slide = table["friction"] * table[f"{axle}.p_Dy1"] / table[f"{axle}.p_Ky1"]
        assert table[f"effects.{TYRE_SHAPE}.alpha_{axle[0]}"] == pytest.approx(LARGE * slide)


@pytest.mark.slow
def test_no_shape_is_fitted_beside_an_effect_that_explains_all(damped, monkeypatch):
    monkeypatch.setattr(shapes, "_fitted", lambda *_: pytest.fail("fitted"))
    assert name_effects(investigate(damped, "yaw_damping", "aero_drag")).chosen == ["yaw_damping"]


@pytest.mark.slow
@pytest.mark.parametrize(("tyre", "slip"), [("burckhardt", "larger"), ("tm_simple", "surface")])
def test_a_clean_car_on_another_formulas_tyres_reaches_the_noise(tyre, slip, tmp_path):
    words = ["--set", "clean", "--programmes", "excitation", "--noises", "1", "--seed", "777", "--limit", "1"]
    simulate([str(tmp_path), *words, "--tyre", tyre, "--slip", slip])
    (path,) = (tmp_path / "logs").iterdir()
    plain = investigate(Log.from_table("foreign", pd.read_parquet(path)), "longitudinal_load_transfer", "roll_dynamics")
    decision = name_effects(plain)
    shaped = decision.investigation
    assert decision.chosen == [] and judge(shaped, decision).kind == "none"
    assert plain.base.cost["chassis"].sum() > 1.1 * plain.floor["chassis"]
    assert shaped.base.cost["chassis"].sum() < 1.03 * shaped.floor["chassis"]
    over = {"larger": (0.3, 1.0), "surface": (0.8, 1.2)}[slip]  # 1 for the wheel's speed, less for the larger of both
    assert over[0] < shaped.base.theta[f"effects.{TYRE_SHAPE}.slip_drive"] < over[1]


@pytest.mark.slow
def test_the_shape_is_written_with_the_vehicle(foreign, tmp_path):
    facts = gap(settings_for(foreign, tmp_path, "yaw_damping"), tmp_path / "out")
    assert facts["effects"] == [] and facts["gap"]["after"] < 1.05
    effects = load_vehicle({"file": str(tmp_path / "out" / "model.yaml")}).effects
    assert list(effects) == [TYRE_SHAPE] and isinstance(effects[TYRE_SHAPE], TyreShape)
    assert effects[TYRE_SHAPE].aside_drive != 0.0 and any(TYRE_SHAPE in line for line in facts["remarks"])


@pytest.mark.slow
def test_an_effect_is_found_beside_a_shape():
    log = drive(*WORDS, *OTHER, "+vehicle/effect=yaw_damping", "vehicle.effects.yaw_damping.coefficient=0.3")
    decision = name_effects(investigate(log, "yaw_damping", "longitudinal_load_transfer", "aero_drag"))
    assert decision.investigation.shaped and decision.chosen == ["yaw_damping"]
    assert float(decision.found.vehicle.effects["yaw_damping"].coefficient) == pytest.approx(0.3, rel=0.1)


def test_a_vehicle_that_has_a_shape_keeps_it(foreign):
    shape = TyreShape(**dict.fromkeys(LARGE_AT, 0.1), aside_drive=-0.4, aside_turn_drive=0.4)
    vehicle = replace(configured()[0], effects={TYRE_SHAPE: shape})
    investigation = investigate(foreign, "yaw_damping", vehicle=vehicle)
    decision = name_effects(investigation)
    assert investigation.shaped and decision.investigation is investigation and decision.chosen == []
    assert list(decision.found.vehicle.effects) == [TYRE_SHAPE]
    fitted = decision.found.vehicle.effects[TYRE_SHAPE]
    assert float(fitted.aside_drive) == pytest.approx(-0.4, rel=0.3) and fitted.kappa_r == shape.kappa_r


def test_shapes_have_one_order_whichever_was_found_first():
    """A tyre's shape acts on what two wheels do together: the other way round it is another car."""
    plain = investigate(drive(seconds=20.0), "yaw_damping")
    either = []
    for first in (1, 0):
        found = plain
        for shape in (SHAPES[first], SHAPES[1 - first]):
            found = shapes._with(found, [shape], shape.unknowns(found.vehicle))
        either.append(found.vehicle)
    assert list(either[0].effects) == list(either[1].effects) == [DOUBLE_TRACK, TYRE_SHAPE]
    given = {TYRE_SHAPE: {}, "yaw_damping": {}, DOUBLE_TRACK: {}}
    assert list(in_order(given)) == ["yaw_damping", DOUBLE_TRACK, TYRE_SHAPE]


@pytest.mark.slow
def test_a_clean_car_with_four_wheels_is_a_double_track(tmp_path):
    words = ["--set", "clean", "--programmes", "excitation", "--noises", "1", "--seed", "23", "--limit", "1"]
    simulate([str(tmp_path), *words, "--structure", "four_wheels", "--sensors", "sparse", "--minutes", "5"])
    (path,) = (tmp_path / "logs").iterdir()
    plain = investigate(Log.from_table("four", pd.read_parquet(path)), "steering_nonlinearity", "locked_differential")
    assert plain.base.cost["chassis"].sum() > 1.05 * plain.floor["chassis"]
    decision = name_effects(plain)
    verdict = judge(decision.investigation, decision)
    assert decision.chosen == [] and verdict.kind == "none" and "two wheels on an axle" in verdict.reason
    assert shapes_of(decision.found) == [DOUBLE_TRACK] and shapes_of(plain.base) == []
    width = float(decision.found.vehicle.effects[DOUBLE_TRACK].track_width)
    assert width == pytest.approx(0.2, rel=0.15) and f"{width:.2g} m apart" in said_of(DOUBLE_TRACK, decision.found)


@pytest.mark.slow
def test_an_effect_is_found_on_a_double_track(monkeypatch):
    looked = []

    def watched(investigation, base, name, fitted):
        looked.extend((name, investigation.shapes) for _ in fitted)
        return screen(investigation, base, name, fitted)

    monkeypatch.setattr("racerl.gap.naming.screen", watched)
    wide = [f"+vehicle.effects.{DOUBLE_TRACK}.{name}" for name in ("track_width=0.3", "ackermann=0.0")]
    log = drive(*wide, "+vehicle/effect=yaw_damping", "vehicle.effects.yaw_damping.coefficient=0.15", seconds=180.0)
    decision = name_effects(investigate(log, "yaw_damping", "locked_differential", "steering_nonlinearity"))
    assert decision.chosen == ["yaw_damping"] and shapes_of(decision.found) == [DOUBLE_TRACK]
    assert float(decision.found.vehicle.effects["yaw_damping"].coefficient) == pytest.approx(0.15, rel=0.1)
    # where it was found on a single track it is looked for on the double one
    assert ("yaw_damping", [DOUBLE_TRACK]) in looked and ("yaw_damping", []) not in looked


def test_what_was_fitted_before_is_screened_whatever_first_order_gains_say(monkeypatch):
    asked = []
    monkeypatch.setattr(naming, "shortlist", lambda ahead, astray: ["yaw_damping"])
    monkeypatch.setattr(naming, "lost", lambda investigation, found: set())
    monkeypatch.setattr(naming, "screen", lambda investigation, found, name, fitted: asked.append((name, fitted)))
    investigation = SimpleNamespace(workers=Workers())
    judging = SimpleNamespace(investigation=investigation, ranked=lambda rows, cost: rows)
    decision = SimpleNamespace(found=SimpleNamespace(effects=frozenset({"aero_drag"})), cost={})
    known = [
        SimpleNamespace(name=name, found=SimpleNamespace(vehicle=SimpleNamespace(effects={name: f"as {name} was"})))
        for name in ("yaw_damping", "aero_drag", "drive_split")
    ]
    assert naming._round(judging, decision, {}, known, silent) == []
    assert asked == [("yaw_damping", ["as yaw_damping was"]), ("drive_split", ["as drive_split was"])]


def test_a_shape_that_changes_nothing_is_none():
    right = configured()[0]
    tracks = DoubleTrack(track_width=0.2), DoubleTrack(ackermann=1.0), DoubleTrack(track_width=0.0, ackermann=0.5)
    found = [SimpleNamespace(vehicle=replace(right, effects={DOUBLE_TRACK: each})) for each in tracks]
    assert [shapes_of(each) for each in found] == [[DOUBLE_TRACK], [], []]
    assert shapes_of(SimpleNamespace(vehicle=right)) == []


@pytest.mark.parametrize(
    ("has", "clear", "tried"),
    [
        ([], True, [[DOUBLE_TRACK], [TYRE_SHAPE], [DOUBLE_TRACK, TYRE_SHAPE]]),
        ([], False, [[DOUBLE_TRACK], [TYRE_SHAPE]]),
        ([DOUBLE_TRACK], True, [[TYRE_SHAPE]]),
        ([DOUBLE_TRACK, TYRE_SHAPE], True, []),
    ],
)
def test_a_tyre_that_helps_is_tried_on_a_double_track(has, clear, tried, monkeypatch):
    seen = []

    def trial(judge, decision, best, new):
        seen.append([shape.name for shape in new])
        return SimpleNamespace(row=SimpleNamespace(clear=clear and new[-1].name == TYRE_SHAPE))

    monkeypatch.setattr(shapes, "_trial", trial)
    vehicle = SimpleNamespace(effects=dict.fromkeys(has))
    judge = SimpleNamespace(investigation=SimpleNamespace(vehicle=vehicle))
    assert len(list(shapes._trials(judge, None, []))) == len(tried) and seen == tried
