"""Numbers that were configured wrongly: which they are, what they should be, and that no effect is taken for them."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import racerl.gap.numbers as numbers_module
from racerl.gap.configurable import NUMBERS
from racerl.gap.diagnose import gap
from racerl.gap.naming import name_effects
from racerl.gap.numbers import as_configured, wrong_numbers
from racerl.gap.sentences import numbers_told
from racerl.report.gap_page import draw_gap
from racerl.vehicle.load import load_vehicle
from racerl.vehicle.parameter import replace_values, values
from tests.gap.conftest import configured, drive, investigate, settings_for

OFF = {"friction": 0.5, "yaw_inertia": 0.19, "steering.time_constant": 0.06}


@pytest.fixture(scope="module")
def off():
    """A short drive of a car with less grip, more yaw inertia and a slower steering than configured."""
    return drive(*(f"vehicle.{name}={value}" for name, value in OFF.items()))


@pytest.fixture(scope="module")
def refitted(off):
    return investigate(off, "yaw_damping")


def test_wrong_numbers_are_found_with_their_values_and_nothing_else_is_changed(refitted):
    decision, told = name_effects(refitted), []
    numbers = wrong_numbers(refitted, decision.found, lambda what, share: told.append(share))
    assert len(told) > 1 and told == sorted(told)
    facts = as_configured(refitted, numbers, 3.0)
    assert not decision.found.effects and facts["rest"] == 0.0 and facts["error"] == 3.0
    assert {row["parameter"]: row["to"] for row in facts["changes"]} == pytest.approx(OFF, rel=0.02)
    assert all(row["ci95"][0] <= row["to"] <= row["ci95"][1] for row in facts["changes"])
    assert facts["explained"] > 0.97
    asked, found = values(configured()[0]), values(numbers.found.vehicle)
    assert {name: found[name] for name in found if name not in OFF} == {n: asked[n] for n in asked if n not in OFF}


def test_what_is_held_is_not_found_wrong(refitted):
    kept = refitted.limited({"friction": (0.8, 0.8)})
    numbers = wrong_numbers(kept, kept.base)
    assert "friction" not in numbers.gained and float(numbers.found.vehicle.friction) == 0.8
    assert numbers.gained  # grip of the tyres, say, stands in for it


def test_a_vehicle_that_blows_up_is_left_to_the_refit(refitted, monkeypatch):
    broken = replace(refitted.base, cost={**refitted.base.cost, "chassis": np.full(5, np.inf)})
    monkeypatch.setattr(numbers_module, "unfitted", lambda investigation: broken)
    numbers = wrong_numbers(refitted, refitted.base)
    assert not numbers.gained and numbers.rest == 1.0 and numbers.vehicle is refitted.base


@pytest.mark.parametrize(
    ("hold", "known", "less"),
    [
        ((), set(OFF), "3[78]%"),
        pytest.param(("yaw_inertia",), {"friction"}, "42%", marks=pytest.mark.slow),  # which the inertia draws by 7 %
    ],
)
def test_the_vehicle_that_is_written_has_the_numbers_told_and_is_the_one_that_was_proved(
    off, tmp_path, hold, known, less
):
    priors, out = settings_for(off, tmp_path)["priors"], tmp_path / "out"
    held = {"hold": list(hold), "priors": {**priors, "steering.time_constant": None}} if hold else {}
    facts = gap(settings_for(off, tmp_path, "yaw_damping", **held), out)
    told = {row["parameter"]: row["to"] for row in facts["configured"]["changes"]}
    assert set(told) >= known and not set(told) & (set(OFF) - known)
    written = values(load_vehicle({"file": str(out / "model.yaml")}))
    if not facts["configured"]["rest"]:
        assert {name: written[name] for name in told} == pytest.approx(told, rel=1e-4)
        assert facts["verdict"] == "none" and facts["gap"]["after"] < 1.1
    assert told["friction"] == pytest.approx(OFF["friction"], rel=0.1)
    assert re.search(f"Grip of the floor: {less} less than configured", draw_gap(out).read_text())


@pytest.mark.slow
def test_a_right_vehicle_stays_as_it_is(clean, tmp_path):
    settings = settings_for(clean, tmp_path, "yaw_damping")
    facts = gap(settings, tmp_path / "out")
    assert facts["configured"]["changes"] == [] and facts["configured"]["rest"] == 0.0
    assert load_vehicle({"file": str(tmp_path / "out" / "model.yaml")}) == load_vehicle(settings["vehicle"])


def test_an_effect_is_no_wrong_number(damped):
    investigation = investigate(damped, "yaw_damping")
    numbers = wrong_numbers(investigation, name_effects(investigation).found)
    assert not numbers.gained and numbers.explained == numbers.rest == 0.0
    assert as_configured(investigation, numbers, 1.0)["changes"] == []
    plain = replace(numbers.found.vehicle, effects={})
    assert values(plain) == values(configured()[0])  # the vehicle as configured, and the effect
    assert float(numbers.found.vehicle.effects["yaw_damping"].coefficient) == pytest.approx(0.15, rel=0.1)


@pytest.mark.slow
def test_an_effect_and_a_wrong_number_are_told_apart():
    log = drive(
        "vehicle.friction=0.6",
        "+vehicle/effect=yaw_damping",
        "vehicle.effects.yaw_damping.coefficient=0.15",
        seconds=90.0,
    )
    investigation = investigate(log, "yaw_damping", "aero_drag")
    decision = name_effects(investigation)
    numbers = wrong_numbers(investigation, decision.found)
    assert decision.found.effects == {"yaw_damping"} and list(numbers.gained) == ["friction"]
    assert float(numbers.found.vehicle.friction) == pytest.approx(0.6, rel=0.05)


@pytest.mark.slow
def test_what_no_few_numbers_explain_is_left_to_a_refit_around_them():
    """Less grip, and tyres of another shape."""
    shape = [
        f"vehicle.{axle}.{name}" for axle in ("front", "rear") for name in ("p_Cy1=1.3", "p_Ey1=-0.5", "p_Cx1=1.3")
    ]
    investigation = investigate(drive("vehicle.friction=0.5", *shape))
    numbers = wrong_numbers(investigation, investigation.base)
    assert numbers.rest > 0.0 and numbers.explained + numbers.rest > 0.8 and numbers.vehicle is numbers.refitted
    asked = values(configured()[0])
    for name in set(numbers.gained) - {"friction"}:  # what the refit takes back is not told
        told, refit = numbers.found.theta[name] - asked[name], numbers.vehicle.theta[name] - asked[name]
        assert refit / told > 0.5


def test_a_number_that_runs_away_is_not_told(refitted, monkeypatch):
    monkeypatch.setattr(numbers_module, "REACH", 1.2)
    gained = wrong_numbers(refitted, refitted.base).gained
    assert not {"friction", "yaw_inertia", "steering.time_constant"} & set(gained)  # each is off by more than that


def test_grip_is_what_the_tyres_give_whichever_coefficient_has_it():
    car, size = configured()[0], numbers_module._size
    table = values(car)
    half = replace_values(car, {"friction": 0.5 * table["friction"]})
    assert size("friction", half) == pytest.approx(0.5 * size("friction", car), rel=0.1)
    assert size("rear.p_Dy1", half) == pytest.approx(size("rear.p_Dy1", car), rel=0.1)  # over the floor's
    same = {name: 2.0 * table[name] for name in numbers_module.ALL_PEAKS}
    assert size("friction", replace_values(half, same)) == pytest.approx(size("friction", car))
    flat = replace_values(car, {"front.p_Dy1": 1.5 * table["front.p_Dy1"], "front.p_Cy1": 0.45})  # no peak in reach
    assert size("front.p_Dy1", flat) < 1.1 * size("front.p_Dy1", car)
    assert size("yaw_inertia", car) == table["yaw_inertia"]


@pytest.mark.parametrize(
    # shares of the gap; the gap and what the refit leaves, over the noise's cost; what stays
    ("gains", "gap_size", "left", "held"),
    [
        ({}, 5.0, 0.0, ["yaw_inertia", "l_f"]),
        ({"yaw_inertia+l_f": 0.02}, 4.0, 0.1, ["yaw_inertia", "l_f"]),  # clear, but not worth telling of
        ({"yaw_inertia+l_f": 0.1}, 0.5, 0.1, ["yaw_inertia"]),  # what the refit knows may move
        ({"yaw_inertia+l_f": 0.1, "yaw_inertia": 0.1}, 0.5, 0.1, []),
        ({"yaw_inertia+l_f": 0.02}, 20.0, 0.5, ["yaw_inertia"]),  # little of a large gap, but much beside what is left
        ({"yaw_inertia+l_f": 0.02}, 20.0, 1.0, ["yaw_inertia", "l_f"]),  # less than half of what is left
    ],
)
def test_body_and_actuators_stay_where_they_were_unless_held_out_windows_ask_for_more(
    monkeypatch, gains, gap_size, left, held
):
    class Fit(str):
        cost = None

    few = SimpleNamespace(found=SimpleNamespace(theta={"yaw_inertia": 0.12, "l_f": 0.16, "drive.time_constant": 0.04}))
    ranges = {
        "yaw_inertia": (0.10, 0.08, 0.13),
        "l_f": (0.17, 0.168, 0.172),
        "drive.time_constant": (0.0401, 0.03, 0.05),
    }
    monkeypatch.setattr(numbers_module, "intervals", lambda *_: ranges)
    monkeypatch.setattr(numbers_module, "_refitted", lambda gap, few, names: Fit("+".join(names)))
    gap = SimpleNamespace(
        investigation=SimpleNamespace(floor={"chassis": 1.0}),
        open=["chassis"],
        held_out=lambda found: found,
        gains=lambda still, *_: still in gains,
        gain=lambda still, *_: gains.get(still, 0.0),
        fall=lambda still, *_: gap_size * gains.get(still, 0.0),
        _excess=lambda *_: left,
    )
    gap.slight = lambda *fits: numbers_module._Gap.slight(gap, *fits)
    around = SimpleNamespace(found=None, cost=None)
    assert numbers_module._left_alone(gap, few, around) == ("+".join(held) or around)


def test_numbers_are_parameters_of_the_vehicle():
    assert set(NUMBERS) <= set(values(configured()[0]))


def test_wrong_numbers_in_words():
    less = {
        "parameter": "friction",
        "what": "grip of the floor",
        "from": 0.8,
        "to": 0.5,
        "ci95": [0.49, 0.51],
        "explained": 0.98,
        "stages": ["chassis"],
    }
    told = numbers_told({"changes": [less, {**less, "to": 1.0, "stages": ["steering", "chassis"]}], "rest": 0.12})
    assert told[0].startswith("grip of the floor: 38% less than configured, friction 0.5 (0.49 … 0.51) instead of 0.8")
    assert told[0].endswith("98% of the error of the vehicle as configured, in the motion")
    assert "25% more" in told[1] and told[1].endswith("in the steering and the motion")
    assert "explains another 12%" in told[2] and len(told) == 3
    assert numbers_told({"changes": [], "rest": 0.5}) == []
