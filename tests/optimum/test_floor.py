"""Laps know the time-optimal lap of their own car, track and limits, and of no other."""

import json

import pytest

from racerl.assemble import build_action, build_track, build_vehicle
from racerl.config import compose_settings
from racerl.evaluate.evaluate import evaluate
from racerl.optimum.floor import find_floor, gap, problem_hash
from racerl.report.report import report
from racerl.run import RunFolder, find_runs


def problem(*words: str) -> str:
    settings = compose_settings("optimum", list(words))
    return problem_hash(build_vehicle(settings), build_track(settings), build_action(settings))


def test_a_problem_is_its_car_track_and_limits():
    same = problem()
    assert problem("sim.dt=0.1") == same
    others = ["vehicle=published", "vehicle.friction=0.81", "action.rate_max=4.9", "sim=no_actuators", "action=speed"]
    assert len({same, *map(problem, others)}) == 1 + len(others)


def test_laps_are_set_against_the_newest_floor_of_their_problem(smoke_run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name, of, time in (("a", problem(), 9.0), ("b", problem(), 5.0), ("c", problem("vehicle=published"), 1.0)):
        folder = RunFolder.start(tmp_path / "outputs" / "optimum" / name, "optimum", {"name": name})
        folder.finish(problem=of, time_s=time)
    assert find_floor(problem(), find_runs(tmp_path / "outputs")) == 5.0
    assert find_floor("another", find_runs(tmp_path / "outputs")) is None
    out = tmp_path / "outputs" / "evaluate" / "a"
    metrics = evaluate(compose_settings("evaluate", [f"run='{smoke_run}'", "laps=1", "seeds=[0]"]), out)
    assert metrics["optimum_s"] == 5.0
    assert metrics["mean_over_optimum"] == gap(metrics["mean_lap_s"], 5.0)
    assert json.loads((out / "metrics.json").read_text())["optimum_s"] == 5.0
    page = report({"runs": [str(out)]}, tmp_path / "page").read_text()
    assert "over the optimum" in page and "no time-optimal lap" not in page


def test_gap():
    assert gap(5.5, 5.0) == pytest.approx(0.1) and gap(None, 5.0) is None and gap(5.5, None) is None
