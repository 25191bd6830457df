"""Sweeps as files: what is packaged holds together, and a mistake in one's own is told in one line."""

import pytest
import yaml

from racerl.config import compose_settings
from racerl.errors import RacerlError
from racerl.sweep.definition import METRICS, Comparison, folder, read_sweeps
from racerl.sweep.jobs import plan

NAMES = sorted(path.stem for path in folder().glob("*.yaml"))


@pytest.mark.parametrize("name", NAMES)
def test_every_packaged_sweep_can_be_read(name):
    for sweep in read_sweeps(name):
        assert sweep.question and sweep.seeds and set(sweep.metrics) <= set(METRICS)
        measured = {test.metric for claim in sweep.claims for test in claim.tests}
        assert measured <= set(sweep.metrics), "what decides a claim is shown"


def test_the_ablations_are_the_papers(tmp_path):
    sweeps = read_sweeps("ablations")
    assert sorted(claim.number for sweep in sweeps for claim in sweep.claims) == list(range(1, 11))
    settings = {"words": [], "threads": 1, "seeds": [0], "laps": 1, "starts": [0], "cars": ["model"]}
    jobs = plan(sweeps, settings, tmp_path, compose_settings).jobs
    assert sum(job.train is not None for job in jobs) == 10
    rivals = {job.name for job in jobs if job.train is None}
    assert rivals == {"mpc", "pure_pursuit", "optimum", "human", "human_like"}


def test_a_driver_is_no_training_however_its_word_is_given(tmp_path, monkeypatch):
    write(tmp_path, monkeypatch, arms={"a": [], "b": ["+controller=mpc"]})
    settings = {"words": [], "threads": 1, "seeds": [0, 1], "laps": 1, "starts": [0], "cars": ["model"]}
    jobs = plan(read_sweeps("mine"), settings, tmp_path, compose_settings).jobs
    assert [job.name for job in jobs if job.train is None] == ["b"] and len(jobs) == 3


def test_an_arm_has_no_seed_of_its_own(tmp_path, monkeypatch):
    write(tmp_path, monkeypatch, arms={"a": ["seed=3"]}, claims=None)
    settings = {"words": [], "threads": 1, "seeds": [0], "laps": 1, "starts": [0], "cars": ["model"]}
    with pytest.raises(RacerlError, match="a sweep has several; give seeds="):
        plan(read_sweeps("mine"), settings, tmp_path, compose_settings)


@pytest.mark.parametrize("budget, steps", [("smoke", 2048), ("laptop", None), ("paper", None)])
def test_a_trial_is_known_by_its_budget(tmp_path, budget, steps):
    settings = {"words": [f"budget={budget}"], "threads": 1, "seeds": [0], "laps": 1, "starts": [0], "cars": ["model"]}
    assert plan(read_sweeps("action_space"), settings, tmp_path, compose_settings).trial_steps == steps


def write(tmp_path, monkeypatch, **changes):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "sweeps").mkdir()
    content = {
        "question": "Which?",
        "base": [],
        "arms": {"a": ["dr=none"], "b": ["dr=friction_0.1"]},
        "seeds": [0],
        "metrics": ["lap_time"],
        "claims": {
            1: {"says": "b is slower", "tests": [{"metric": "lap_time", "contrast": {"b": 1, "a": -1}, "above": 0}]}
        },
    }
    content |= changes
    text = yaml.safe_dump({key: value for key, value in content.items() if value is not None})
    (tmp_path / "sweeps" / "mine.yaml").write_text(text)


def test_a_users_sweep_comes_first(tmp_path, monkeypatch):
    write(tmp_path, monkeypatch)
    (sweep,) = read_sweeps("mine")
    assert sweep.arms["b"] == ("dr=friction_0.1",) and sweep.claims[0].tests[0].weights == {"b": 1.0, "a": -1.0}


def test_a_sweep_names_its_cars_and_a_list_of_sweeps_may_name_their_twins(tmp_path, monkeypatch):
    write(tmp_path, monkeypatch, cars=["model", "twin_slippery"], twins=["twin_half"])
    (sweep,) = read_sweeps("mine")
    assert sweep.cars == ("model", "twin_slippery") and sweep.twins == ("twin_half",)
    listing = tmp_path / "sweeps" / "all.yaml"
    listing.write_text("sweeps: [mine, action_space]\n")
    mine, other = read_sweeps("all")
    assert mine.twins == ("twin_half",) and other.cars == ("model", "twin") and other.twins == ()
    listing.write_text("sweeps: [mine, action_space]\ntwins: [twin_double]\n")
    assert [sweep.twins for sweep in read_sweeps("all")] == [("twin_double",)] * 2
    listing.write_text("sweeps: [mine]\ntwin: [twin_double]\n")
    with pytest.raises(RacerlError, match=r"unknown key 'twin'.*twins"):
        read_sweeps("all")
    listing.write_text("sweeps: []\n")
    with pytest.raises(RacerlError, match=r"sweeps = \[\]: one at least"):
        read_sweeps("all")


def claiming(**test):
    return {1: {"says": "so", "tests": [{"metric": "lap_time", "contrast": {"a": 1}, "above": 0} | test]}}


@pytest.mark.parametrize(
    "changes, said",
    [
        ({"arm": {}}, "unknown key 'arm'.*arms"),
        ({"question": None}, "question is missing"),
        ({"arms": ["a"]}, "mapping"),
        ({"arms": {"a": "dr=none"}}, "list of words"),
        ({"seeds": [-1]}, "seeds = -1"),
        ({"metrics": ["laptime"]}, "unknown metric 'laptime'.*lap_time"),
        ({"claims": claiming(metric="laps")}, "unknown metric 'laps'"),
        ({"claims": claiming(contrast={"c": 1})}, "no arm 'c'"),
        ({"claims": claiming(below=1)}, "one limit"),
        ({"claims": claiming(slope={"a": 1})}, "either contrast or slope"),
        ({"claims": claiming(unter=1)}, "no setting 'unter'"),
        ({"claims": {1: {"says": "so"}}}, "says and tests"),
        ({"claims": claiming(contrast={}, slope={"a": 1, "b": 1})}, "two different numbers"),
        ({"claims": claiming(above="zero")}, "above = zero"),
        ({"claims": claiming(car="twn")}, "no car 'twn'.*twin"),
        ({"claims": [1]}, "claims is a mapping"),
        ({"claims": {1: {"says": "so", "tests": 3}}}, "tests is a list"),
        ({"cars": []}, "one at least"),
        ({"seeds": []}, "seeds = .*one at least"),
        ({"twins": "twin_half"}, "list of words"),
    ],
)
def test_a_mistake_is_told(tmp_path, monkeypatch, changes, said):
    write(tmp_path, monkeypatch, **changes)
    with pytest.raises(RacerlError, match=said):
        read_sweeps("mine")


@pytest.mark.parametrize("name", ["ablation", "../conf/train", "nothing"])
def test_an_unknown_sweep_is_told(name):
    with pytest.raises(RacerlError, match="unknown sweep"):
        read_sweeps(name)


def test_the_slope_is_that_of_least_squares():
    points = {"a": 0.0, "b": 0.02, "c": 0.05, "d": 0.1}
    weights = Comparison(metric="lap_time", slope=points, above=0.0).weights
    assert sum(weight * (3.0 + 7.0 * points[arm]) for arm, weight in weights.items()) == pytest.approx(7.0)


@pytest.mark.parametrize(
    "limit, low, high, holds",
    [
        ({"above": 1.0}, 1.1, 2.0, True),
        ({"above": 1.0}, 0.5, 0.9, False),
        ({"above": 1.0}, 0.9, 1.1, None),
        ({"below": 0.0}, -2.0, -1.0, True),
        ({"below": 0.0}, 0.1, 1.0, False),
        ({"within": 0.1}, -0.05, 0.09, True),
        ({"within": 0.1}, 0.2, 0.3, False),
        ({"within": 0.1}, -0.2, 0.3, None),
    ],
)
def test_which_side_an_interval_lies_on(limit, low, high, holds):
    assert Comparison(metric="lap_time", contrast={"a": 1.0}, **limit).holds(low, high) is holds
