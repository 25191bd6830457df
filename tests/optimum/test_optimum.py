"""The time-optimal lap: feasible in the race's own integrator, symmetric, and below every lap that was ever driven."""

import json
import pickle
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import torch

from racerl.assemble import build_action, build_track, build_vehicle
from racerl.config import compose_settings
from racerl.errors import OptimumError, RacerlError
from racerl.optimum.collocation import Collocation
from racerl.optimum.corridor import Corridor
from racerl.optimum.held import hold
from racerl.optimum.optimum import (
    RACELINE,
    RESULT,
    SLIDING,
    different,
    find_optimum,
    margins,
    optimum,
    raceline,
    replay,
    starts,
    trajectory,
)
from racerl.track.raceline import read_raceline
from racerl.track.track import Track
from racerl.track.track import build_track as spline_track
from tests.conftest import CONF

REFERENCE = CONF.parent / "outputs" / "reference"


def closed(x: np.ndarray, y: np.ndarray, half: float) -> Track:
    width = np.full(len(x), half)
    return spline_track("made", np.stack([x, y], axis=1), width, width)


def oval() -> Track:
    angle = np.linspace(0, 2 * np.pi, 80, endpoint=False)
    return closed(8 * np.cos(angle), 2.5 * np.sin(angle), 0.8)


def clover() -> Track:
    """Turns to both sides."""
    angle = np.linspace(0, 2 * np.pi, 160, endpoint=False)
    radius = 5 + 1.5 * np.cos(3 * angle)
    return closed(radius * np.cos(angle), radius * np.sin(angle), 0.6)


@pytest.fixture(scope="module")
def parts():
    settings = compose_settings("optimum", [])
    return build_vehicle(settings), build_track(settings), build_action(settings)


@pytest.fixture(scope="module")
def found(parts, once):
    """The default car's lap, and the same with its commands held."""

    def find(folder):
        best = find_optimum(*parts)
        folder.mkdir()
        (folder / "lap").write_bytes(pickle.dumps((best, hold(best.corridor, best.solution, 0.05, 5))))

    return pickle.loads((once("optimum", find) / "lap").read_bytes())  # noqa: S301


@pytest.fixture(scope="module")
def best(found):
    return found[0]


@pytest.fixture(scope="module")
def held(found):
    return found[1]


@pytest.mark.slow
def test_it_settles_from_the_best_of_its_guesses(best, parts):
    assert abs(best.meshes[-1]["time_s"] / best.meshes[-2]["time_s"] - 1) < 1e-3
    problem = Collocation(*(parts[0], parts[2]), best.corridor, best.meshes[0]["intervals"])
    along, sliding = (problem.solve(problem.guess(way)).time for way in (0.0, 1.2))
    assert sliding < along  # this car gains from sliding, and the better guess was taken
    assert best.meshes[0]["time_s"] == pytest.approx(sliding, abs=1e-6)


def test_a_car_that_may_grip_or_slide_round_has_two_ways():
    settings = compose_settings("optimum", ["vehicle=jetracer", "track=oval"])
    corridor = Corridor(build_track(settings))
    laps = starts(Collocation(build_vehicle(settings), build_action(settings), corridor, 94))
    fast, slow = different(laps)
    assert fast["time_s"] == min(lap.time for lap in laps) and slow["time_s"] > 1.03 * fast["time_s"]
    assert fast["sideslip_rad"] > slow["sideslip_rad"] + 0.2  # it slides, the other does less
    assert len(laps) == len(SLIDING)  # two of them are the same lap, told once


@pytest.mark.parametrize(
    "make",
    [*(pytest.param(made, marks=pytest.mark.slow) for made in (oval, clover)), None],
    ids=["oval", "clover", "l_shape"],
)
def test_held_commands_drive_the_lap_in_the_race_integrator(make, parts, best, held):
    vehicle, l_shape, action = parts
    track = make() if make else l_shape
    lap = find_optimum(vehicle, track, action) if make else best
    held = hold(lap.corridor, lap.solution, 0.05, 5) if make else held
    assert held.period == pytest.approx(0.05, rel=0.01)
    assert held.time == pytest.approx(lap.time, rel=5e-3)
    driven = replay(vehicle, held)
    assert np.hypot(*(driven[:2] - held.states[:2, ::5])).max() < 1e-3
    assert margins(track, driven[0], driven[1]).min() > -2e-3
    assert np.hypot(*(driven[:2, -1] - driven[:2, 0])) < 1e-3
    assert np.abs(held.references[0]).max() <= action.steering_max + 1e-6
    rate = np.diff(held.references[1], append=held.references[1, :1]) / held.period
    assert np.abs(rate).max() <= action.rate_max * (1 + 1e-6)


@pytest.mark.slow
def test_a_mirrored_track_takes_as_long(parts, coarse):
    vehicle, track, action = parts
    mirrored = replace(
        track,
        y=-track.y,
        yaw=-track.yaw,
        curvature=-track.curvature,
        width_left=track.width_right,
        width_right=track.width_left,
    )
    assert coarse_time(vehicle, mirrored, action) == pytest.approx(coarse, rel=1e-3)


@pytest.fixture(scope="module")
def coarse(parts):
    return coarse_time(*parts)


def coarse_time(vehicle, track, action) -> float:
    """Return the time in s of the lap on a coarse mesh that the most sliding guess leads to."""
    problem = Collocation(vehicle, action, Corridor(track), 98)
    return problem.solve(problem.guess(SLIDING[-1])).time


@pytest.mark.slow
def test_grip_room_and_power_make_it_faster(parts, coarse):
    vehicle, track, action = parts

    def time(vehicle=vehicle, track=track, action=action) -> float:
        return coarse_time(vehicle, track, action)

    assert time(vehicle=replace(vehicle, friction=1.1 * vehicle.friction)) < 0.97 * coarse
    wider = replace(track, width_left=track.width_left + 0.1, width_right=track.width_right + 0.1)
    assert time(track=wider) < 0.97 * coarse
    assert time(action=replace(action, rate_max=2.0)) > 1.005 * coarse


def test_the_corridor_ends_where_the_race_ends_it(parts):
    track = parts[1]
    corridor = Corridor(track)
    stretch = corridor.at(np.linspace(0, corridor.length, 150, endpoint=False))
    assert (stretch.low < -0.02).all() and (stretch.high > 0.02).all()
    assert (1 - stretch.curvature * stretch.high > 0.09).all() and (1 - stretch.curvature * stretch.low > 0.09).all()
    for bound in (stretch.low, stretch.high):
        x, y = stretch.x - bound * np.sin(stretch.yaw), stretch.y + bound * np.cos(stretch.yaw)
        at_edge = np.abs(margins(track, x, y))
        # the rest is where the normals would cross first
        assert np.quantile(at_edge, 0.9) < 5e-3 and at_edge.max() < 0.5


def test_no_lap_that_is_kept_is_faster(best):
    """The reference laps were driven on the default car and track."""
    laps = [lap for path in REFERENCE.rglob("laps.json") for lap in json.loads(path.read_text())]
    assert laps
    for lap in laps:
        assert lap["fastest_valid_lap_s"] > best.time, lap


def test_the_command_writes_a_raceline(tmp_path, monkeypatch, best, held):
    # of the same car and track
    monkeypatch.setattr("racerl.optimum.optimum.find_optimum", lambda *asked: best)
    monkeypatch.setattr("racerl.optimum.optimum.hold", lambda *asked: held)
    facts = optimum(compose_settings("optimum", []), tmp_path / "lap")
    assert json.loads((tmp_path / "lap" / RESULT).read_text()) == facts
    text = (tmp_path / "lap" / RACELINE).read_text()
    rows = text.splitlines()
    assert [row[0] for row in rows[:4]] == ["#", "#", "#", "0"]
    assert rows[2] == "# s_m; x_m; y_m; psi_rad; kappa_radpm; vx_mps; ax_mps2"
    written = raceline(trajectory(best.solution))
    pd.testing.assert_frame_equal(read_raceline(tmp_path / "lap" / RACELINE), written, atol=1e-7, rtol=0)
    table = pd.read_csv(tmp_path / "lap" / RACELINE, sep=";", skiprows=3, header=None)  # as others read it
    s, x, y, psi, speed = (table.iloc[:, i].to_numpy() for i in (0, 1, 2, 3, 5))
    middle = slice(1, -1)
    course = np.arctan2(np.gradient(y, s), np.gradient(x, s)) - np.pi / 2
    apart = np.mod(psi - course + np.pi, 2 * np.pi) - np.pi
    assert np.abs(apart[middle]).max() < 0.05  # rad
    assert np.sum(np.diff(s) / ((speed[1:] + speed[:-1]) / 2)) == pytest.approx(facts["time_s"], rel=0.002)
    assert (x[-1], y[-1]) == (x[0], y[0])


@pytest.mark.slow
def test_impossible_problems_are_told(parts, monkeypatch):
    vehicle, track, action = parts
    monkeypatch.setattr("racerl.optimum.optimum.SLIDING", SLIDING[:1])  # one guess fails as well as three
    with pytest.raises(OptimumError):
        find_optimum(replace(vehicle, wheelbase=2.0, l_f=1.0), track, action)  # it turns at 3.7 m
    with pytest.raises(RacerlError, match="commands motor_current"):
        build_action(compose_settings("optimum", ["action=current"]))


def test_other_drives(parts):
    settings = compose_settings("optimum", ["sim=motor_current", "action=current"])
    vehicle, action = build_vehicle(settings), build_action(settings)
    corridor = Corridor(parts[1])
    problem = Collocation(vehicle, action, corridor, 98)
    current = problem.solve(problem.guess(0.0))
    assert 3.0 < current.time < 8.0 and torch.isfinite(torch.as_tensor(current.references)).all()


def test_the_line_of_a_hairpin_wider_than_its_radius_has_no_kink():
    """Offsets beyond the centre of curvature would fold it: real maps have 1.1 m of room at a radius of 0.8 m."""
    angle = np.linspace(-np.pi / 2, np.pi / 2, 10)
    straight = np.linspace(0.0, 6.0, 13)[1:-1]
    right = np.stack([6.0 + 0.8 * np.cos(angle), 0.8 * np.sin(angle)], axis=1)
    left = np.stack([-0.8 * np.cos(angle), -0.8 * np.sin(angle)], axis=1)
    there, back = (np.stack([x, np.full(len(x), y)], axis=1) for x, y in ((straight, -0.8), (straight[::-1], 0.8)))
    points = np.concatenate([there, right, back, left])
    width = np.where(np.abs(points[:, 0] - 3.0) > 3.0, 1.1, 0.5)
    track = spline_track("bone", points, width, width)
    stretch = Corridor(track).at(np.linspace(0.0, 12.0, 400))
    assert np.abs(stretch.curvature).max() < 2.0  # 2.9 where it may fold; below, each processor rounds to its own line
    assert np.minimum(1 - stretch.curvature * stretch.high, 1 - stretch.curvature * stretch.low).min() > 0.1
