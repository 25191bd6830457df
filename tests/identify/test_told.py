"""What a log tells, and what it leaves open: circles alone, ratios, and numbers that stay as configured."""

from types import SimpleNamespace

import numpy as np
import pytest
import yaml

from racerl.config import compose_settings
from racerl.estimation.unknowns import Unknowns
from racerl.identify.identify import identify
from racerl.identify.told import open_questions, posterior
from racerl.record.record import Plan, table

TRUTH = {"front.p_Ky1": 2.6, "rear.p_Ky1": 4.2, "steering.time_constant": 0.08}


def unknowns(*names):
    ones = np.ones(len(names))
    return Unknowns(names, ones, 0.2 * ones, 0.0 * ones, 9.0 * ones, (None,) * len(names))


def told(names, H, penalty=1.0):
    """Return what is left open by data with the information H over the names, in the priors' deviations."""
    all_of_them = unknowns(*names)
    scale = np.outer(all_of_them.sigma, all_of_them.sigma)
    linearised = SimpleNamespace(reduced=lambda: (np.array(H)[None] / scale, None))
    objective = SimpleNamespace(unknowns=all_of_them, penalty=penalty)
    return open_questions(all_of_them, *posterior(SimpleNamespace(linearised=linearised), objective))


def test_what_the_data_say_less_of_than_the_prior_is_open():
    found = told(["yaw_inertia", "front.p_Ky1", "rear.r_Bx1"], np.diag([0.01, 100.0, 0.1]))
    assert found["untold"] == {
        "yaw inertia": ["yaw_inertia"],
        "grip in both directions at once": ["rear.r_Bx1"],
    }
    assert found["told"] == 1 and found["together"] == []
    assert found["drive"] == ["step steers and slaloms", "power and brakes in turns"]
    assert found["says"] == [
        "this log does not tell, so it stays as configured: yaw inertia (yaw_inertia); grip in both directions at once "
        "(rear.r_Bx1)",
        "to know more, drive step steers and slaloms, power and brakes in turns",
    ]


@pytest.mark.parametrize(("way", "what"), [(-1.0, "ratio"), (1.0, "product")])
def test_what_is_told_only_together_is_said_so(way, what):
    direction = np.array([1.0, way, 0.0])  # of a ratio, the data know the difference of logarithms
    found = told(["front.p_Ky1", "yaw_inertia", "l_f"], 1e3 * np.outer(direction, direction) + np.diag([0, 0, 1e3]))
    assert found["together"] == [{"parameters": ["front.p_Ky1", "yaw_inertia"], "as": what}]
    assert f"front.p_Ky1 and yaw_inertia are told only as a {what}" in found["says"]


def test_two_numbers_that_are_told_well_are_not_spoken_of():
    direction = np.array([1.0, -1.0])
    assert told(["front.p_Ky1", "yaw_inertia"], 1e6 * np.outer(direction, direction) + 1e3 * np.eye(2))["says"] == []


def test_nothing_is_open_where_all_is_told():
    assert told(["front.p_Ky1", "yaw_inertia"], 100.0 * np.eye(2))["says"] == []


@pytest.fixture(scope="module")
def drive():
    words = [f"vehicle.{name}={value}" for name, value in TRUTH.items()]
    settings = compose_settings("record", ["vehicle=published", "seconds=180", *words])
    return table(Plan.of(settings).drive(), **settings["smoothing"])


def identified(rows, folder, **changes):
    rows.to_parquet(folder / "log.parquet", index=False)
    words = [f"logs=['{folder}/log.parquet']", "vehicle=published", "starts=1", "folds=0", "threads=1"]
    facts = identify({**compose_settings("identify", words), **changes}, folder / "out")
    return facts, (folder / "out" / "model.yaml").read_text()


def test_circles_alone_leave_the_steering_as_configured_and_say_so(drive, tmp_path):
    """A steering command that never changes says nothing of how fast it is answered."""
    change = (drive["manoeuvre"] != drive["manoeuvre"].shift()).cumsum()
    circles = drive[drive["manoeuvre"] == "circle"].assign(run=change)
    steady = circles.groupby("run").cumcount() >= 60  # the car has come to its circle
    facts, model = identified(circles[steady].drop(columns="manoeuvre"), tmp_path)
    assert facts["parameters"]["steering.time_constant"]["value"] == 0.044
    for name in ("front.p_Ky1", "rear.p_Ky1"):  # these a circle does tell
        assert facts["parameters"][name]["value"] == pytest.approx(TRUTH[name], rel=0.05)
    assert "steering.time_constant" in facts["open"]["untold"]["how fast the steering answers"]
    assert "step steers" in facts["open"]["says"][-1]
    (line,) = [line for line in model.splitlines() if "time_constant: 0.044 " in line]
    assert "not told by the log, as configured" in line
    held = {name for names in facts["open"]["untold"].values() for name in names}
    assert all(facts["parameters"][name]["value"] == facts["parameters"][name]["start"] for name in held)
    assert yaml.safe_load(model)["front"]["p_Ky1"] == pytest.approx(TRUTH["front.p_Ky1"], rel=0.05)
