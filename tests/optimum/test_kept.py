"""Time-optimal laps that are kept: found once, by one process, for exactly their car, track and limits."""

import json
import threading
from dataclasses import replace
from pathlib import Path

import casadi
import numpy as np
import pytest

from racerl.assemble import build_action, build_track, build_vehicle
from racerl.config import compose_settings
from racerl.control.stage_qp import StageQp
from racerl.errors import OptimumError
from racerl.optimum import collocation, kept
from racerl.optimum.collocation import Collocation, minimise
from racerl.optimum.corridor import Corridor
from racerl.optimum.optimum import Optimum


@pytest.fixture(scope="module")
def parts():
    settings = compose_settings("optimum")
    return build_vehicle(settings), build_track(settings), build_action(settings)


@pytest.fixture(scope="module")
def coarse(parts):
    """A lap on a mesh that takes a second."""
    vehicle, track, action = parts
    corridor = Corridor(track)
    problem = Collocation(vehicle, action, corridor, 60)
    return Optimum(problem.solve(problem.guess(0.0)), corridor, [], [])


@pytest.fixture
def asked(coarse, tmp_path, monkeypatch):
    """An empty cache; the list of problems that were solved."""
    solved = []

    def find(vehicle, track, action, on_share=None):
        solved.append(vehicle)
        if float(vehicle.friction) < 0.5:
            raise OptimumError("it cannot turn")
        return coarse

    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(kept, "find_optimum", find)
    monkeypatch.chdir(tmp_path)
    return solved


def test_a_lap_is_found_once_and_comes_back_as_it_was(asked, parts, coarse):
    assert kept.known(*parts) is None
    first, again = kept.kept_lap(*parts), kept.kept_lap(*parts)
    assert len(asked) == 1 and first is coarse.solution
    assert again.time == first.time == kept.known(*parts) == kept.found(*parts)
    assert np.array_equal(again.cartesian, first.cartesian) and np.array_equal(again.references, first.references)
    assert again.turn == first.turn


def test_another_car_track_limit_or_equation_is_another_lap(asked, parts, monkeypatch):
    vehicle, track, action = parts
    kept.kept_lap(*parts)
    assert kept.known(replace(vehicle, friction=0.9 * vehicle.friction), track, action) is None
    assert kept.known(vehicle, replace(track, width_left=track.width_left + 0.1), action) is None
    assert kept.known(vehicle, track, replace(action, rate_max=2.0)) is None
    honest = type(vehicle).derivative
    monkeypatch.setattr(type(vehicle), "derivative", lambda *given: 1.01 * honest(*given))
    assert kept.known(*parts) is None


def test_one_finds_it_and_the_others_wait(asked, parts, monkeypatch):
    quick, began = kept.find_optimum, threading.Event()

    def slow(*given):
        began.set()
        other.join(0.3)  # it must not get further than to the lock
        assert other.is_alive()
        return quick(*given)

    monkeypatch.setattr(kept, "find_optimum", slow)
    laps = []
    other = threading.Thread(target=lambda: (began.wait(), laps.append(kept.kept_lap(*parts))))
    other.start()
    lap = kept.kept_lap(*parts)
    other.join()
    assert len(asked) == 1 and laps[0].time == lap.time


@pytest.mark.parametrize(
    "content", ["{", "{}", '{"states": [], "commands": [], "durations": [], "stretch": {}}', "[1]"]
)
def test_what_is_damaged_is_found_again(asked, parts, content):
    kept.kept_lap(*parts)
    (file,) = kept.kept_folder().glob("*.json")
    file.write_text(content)
    assert kept.known(*parts) is None and kept.kept_lap(*parts).time > 0 and len(asked) == 2
    json.loads(file.read_text())


def test_a_cache_that_cannot_be_written_costs_time_alone(asked, parts, monkeypatch, tmp_path):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert kept.found(*parts) == kept.found(*parts) and len(asked) == 2


def test_no_lap_is_one_warning_and_known_from_then_on(asked, parts, caplog):
    slippery = (replace(parts[0], friction=0.4), *parts[1:])
    kept._warn.cache_clear()
    assert kept.found(*slippery) is None and kept.found(*slippery) is None
    assert len(asked) == 1 and [record.message for record in caplog.records] == [
        "laps are not set against a time-optimal one: it cannot turn"
    ]
    assert kept.known(*slippery) is None


def options_of(monkeypatch):
    """Return the list that the options of every solver land in."""
    seen = []

    def listening(make):
        return lambda name, plugin, problem, options: seen.append(options) or make(name, plugin, problem, options)

    for kind in ("nlpsol", "conic"):
        monkeypatch.setattr(casadi, kind, listening(getattr(casadi, kind)))
    return seen


def keys(options):
    for key, value in options.items():
        yield key
        if isinstance(value, dict):
            yield from keys(value)


def test_no_solver_is_limited_in_time(monkeypatch):
    """A result must not depend on how busy the machine is."""
    seen = options_of(monkeypatch)
    x = casadi.MX.sym("x", 2)
    found = minimise(casadi.sumsqr(x), x, x[0] - 1.0, np.zeros(2), np.full(2, -5.0), np.full(2, 5.0))
    assert found == pytest.approx([1.0, 0.0], abs=1e-5)
    StageQp(5, 3, 2)
    named = {key for options in seen for key in keys(options)}
    assert len(seen) == 3 and {"ipopt.max_iter", "iter_max", "max_iter"} <= named
    assert {key for key in named if "time" in key or "cpu" in key} == {"print_time"}
    sources = "".join(path.read_text() for path in Path(collocation.__file__).parents[1].rglob("*.py"))
    assert not any(word in sources for word in ("max_wall_time", "max_cpu_time", "time_limit"))


def test_too_few_iterations_are_told_in_one_line(parts, monkeypatch):
    vehicle, track, action = parts
    monkeypatch.setattr(collocation, "MOST_ITERATIONS", 3)
    problem = Collocation(vehicle, action, Corridor(track), 60)
    with pytest.raises(OptimumError, match="Maximum_Iterations_Exceeded after 3 iterations") as error:
        problem.solve(problem.guess(0.0))
    assert "\n" not in str(error.value)
