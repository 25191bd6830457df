"""The teacher drives near the limit, and a policy that imitates it soon laps cleanly; one that can't learn does not."""

import dataclasses
import json

import numpy as np
import pytest
import torch

from racerl.assemble import build_race
from racerl.config import compose_settings
from racerl.control.policy import load_policy
from racerl.env.termination import Crash
from racerl.errors import ConfigError, OptimumError
from racerl.evaluate.drive import drive
from racerl.evaluate.laps import score
from racerl.optimum.collocation import Collocation
from racerl.optimum.corridor import Corridor
from racerl.optimum.ladder import FULL, find_ladder
from racerl.train import session
from racerl.train.algorithms import create_algorithm
from racerl.train.algorithms.imitation import Imitation
from racerl.train.teacher import CLIMBED, Teacher, find_teacher, left_behind
from racerl.train.train import train
from tests.train.pulled import Plug, logged, pull_at

FLOOR = 5.155  # s, the time-optimal lap of the default car on the default track


@pytest.fixture(scope="module")
def settings():
    return compose_settings("train", ["algo=imitation", "threads=1", "algo.layers=[256,256]", "budget=unrefined"])


@pytest.fixture(scope="module")
def teacher(settings):
    return find_teacher(lambda: build_race(settings, cars=128, seeds=[0]))


@pytest.mark.slow
def test_laps_of_rising_pace(teacher):
    times = [lap.time for lap in teacher.laps]
    assert times == sorted(times, reverse=True) and 1.01 * FLOOR < times[-1] < 1.05 * FLOOR < 1.5 * FLOOR < times[0]


@pytest.mark.slow
def test_the_teacher_climbs_to_the_fastest_lap(settings, teacher):
    race = build_race(settings, cars=128, seeds=[3])
    lost, far = torch.zeros(128, dtype=torch.bool), torch.zeros(128)
    for k in range(300):
        step = race.step(teacher(race))
        lost |= step.terminated
        far += step.progress * (k >= 200)
    assert lost.float().mean() < 0.1
    laps = race.track.length / (far[~lost] / (100 * race.timing.dt))
    assert laps.median() < 1.05 * FLOOR


def test_the_top_lap_is_the_fastest_that_the_feedback_holds(settings, monkeypatch):
    def tried(*shares):
        """Return how many of three laps are climbed where so many are left behind in trials; None: no feedback."""
        left = iter(shares)

        def teacher(race, corridor, laps, known):
            share = next(left)
            if share is None:
                raise OptimumError("no feedback found")
            return len(laps), share

        monkeypatch.setattr("racerl.train.teacher.find_ladder", lambda *parts: ["slow", "quick", "fastest"])
        monkeypatch.setattr("racerl.train.teacher.Teacher", teacher)
        monkeypatch.setattr("racerl.train.teacher.left_behind", lambda made, race: made[1])
        return find_teacher(lambda: build_race(settings, cars=1, seeds=[0]))[0]

    assert tried(0.05) == 3 and tried(0.8, 0.1) == 2 and tried(None, 1.0, 0.0) == 1
    with pytest.raises(OptimumError, match=r"60% of the cars are left behind.*algo=ppo") as error:
        tried(0.9, None, 0.6)
    assert "\n" not in str(error.value)


@pytest.mark.slow
def test_a_lap_that_is_not_found_is_left_out(settings, monkeypatch):
    """The teacher climbs over the gap; without any lap that nothing limits there is none."""

    begun = []

    def found(impossible):
        def solve(problem, guess):
            if impossible(problem):
                raise OptimumError("no lap found")
            if isinstance(guess, Rung):
                begun.append((guess.problem.fastest, problem.fastest))
            return Rung(problem)

        monkeypatch.setattr(Collocation, "solve", solve)
        monkeypatch.setattr("racerl.optimum.ladder.starts", lambda problem: [problem.solve(None)])
        race = build_race(settings, cars=1, seeds=[0])
        return find_ladder(race.vehicle, race.track, race.action, Corridor(race.track))

    laps = found(lambda problem: 2.5 < problem.fastest < 3.5)
    assert [lap.time for lap in laps] == sorted((lap.time for lap in laps), reverse=True)
    assert len(laps) == len(found(lambda problem: False)) - 2
    limited = [pair for pair in begun if pair[1] < np.inf]
    assert limited and all(slower < faster for slower, faster in limited)  # each begins at the lap below it
    assert len(found(lambda problem: problem.fastest < np.inf)) == len(FULL)
    careful = laps[0].room
    assert (
        laps[-1].room < careful == found(lambda problem: problem.room < careful)[-1].room
    )  # the fastest: not possible
    with pytest.raises(OptimumError):
        found(lambda problem: problem.fastest == np.inf)


@dataclasses.dataclass(frozen=True)
class Rung:
    """A lap at the fastest speed that its problem allows, 4 m/s at most, and slower with more room."""

    problem: Collocation
    guess = property(lambda self: self)
    room = property(lambda self: self.problem.room)
    time = property(lambda self: 20.0 / min(self.problem.fastest, 4.0) + self.problem.room)
    states = property(lambda self: np.full((len(self.problem.scale), 1), min(self.problem.fastest, 4.0)))


class Nowhere:
    """A teacher that steers to the left, and thinks that all is well."""

    def __call__(self, race):
        return torch.ones(len(race.age), 2)

    def on_top(self, race):
        return race.age >= 0


@pytest.mark.slow
def test_a_teacher_that_steers_nowhere_loses_the_cars(settings, teacher):
    assert left_behind(Nowhere(), build_race(settings, cars=16, seeds=[1])) > 0.9
    assert left_behind(teacher, build_race(settings, cars=64, seeds=[1])) <= 0.1


@pytest.mark.slow
def test_cars_come_to_the_top_over_laps_that_are_far_apart(settings, teacher, monkeypatch):
    """Where all of a lap is too far from the one below, it is tried where it is nearest."""
    monkeypatch.setattr("racerl.train.teacher.BASIN", 1.5)  # half of it: laps are four times as far apart
    monkeypatch.setattr("racerl.train.teacher.BASIN_SPEED", 1.0)
    race = build_race(settings, cars=64, seeds=[1])
    far = Teacher(race, Corridor(race.track), teacher.laps[:4:3])
    apart = ((far.states[1] - far.states[0]) / far.basin).square().sum(dim=1)
    assert CLIMBED < apart.min() < far.reach[0] < apart.median()
    assert left_behind(far, build_race(settings, cars=64, seeds=[1])) < 0.1
    far.reach = torch.full_like(far.reach, CLIMBED)
    assert left_behind(far, build_race(settings, cars=64, seeds=[1])) > 0.5


@pytest.mark.slow
def test_starts_near_the_fastest_lap_are_on_the_track(settings, teacher):
    race = build_race(settings, cars=64, seeds=[0])
    before = race.state.clone()
    cars = torch.arange(0, 64, 2)
    teacher.start(race, cars, torch.Generator().manual_seed(0))
    assert torch.equal(race.state[:, 1::2], before[:, 1::2])
    assert (race.margin[cars] > -0.2).all() and race.margin[cars].median() > 0
    assert race.v_x[cars].mean() > 1.5 and (race.age[cars] == 0).all()
    again = race.frame.project(race.state[0], race.state[1], race.s)
    assert torch.allclose(again.n, race.n, atol=1e-4)


def driven(settings, path) -> tuple[float, float]:
    """Return laps per car in 10 s from anywhere, and the share of cars that crash."""
    race = build_race(settings, cars=32, seeds=[5], termination=Crash())
    policy, crashed, far = load_policy(path), torch.zeros(32, dtype=torch.bool), torch.zeros(32)
    for _ in range(200):
        step = race.step(policy.act(race))
        crashed |= step.terminated
        far += step.progress
    return float(far.mean()) / race.track.length, float(crashed.float().mean())


class AlongTheMiddle:
    """A teacher that holds the middle of the track at an easy pace, and is there at once."""

    pace = 1.5  # m/s

    def __call__(self, race):
        (bend,) = race.frame.lookup(race.s + 0.3, race.frame.curvature)
        steering = 0.33 * bend - 1.2 * race.offset - race.heading
        return torch.stack([steering / race.action.steering_max, self.pace - race.command[1]], dim=1)

    def start(self, race, cars, generator):
        """Leave the cars where they are."""


@pytest.fixture
def taught(monkeypatch):
    monkeypatch.setattr("racerl.train.algorithms.imitation.find_teacher", lambda build: AlongTheMiddle())


def learns(settings, path):
    """Return what was trained in a moment, and how it drives: laps per car in 10 s, and the share that crashes."""
    quick = {**settings, "algo": {**settings["algo"], "rounds": 9, "cars": 192, "updates": 50, "batch": 1024}}
    quick["algo"]["last_updates"] = 200
    return train(quick, path), *driven(settings, path)


def test_a_policy_learns_from_it(settings, taught, tmp_path):
    facts, laps, crashed = learns(settings, tmp_path / "run")
    assert facts["steps"] == 9 * 192 * 40
    assert crashed < 0.05 and laps > 0.9 * 10.0 * AlongTheMiddle.pace / 17.5
    losses = [json.loads(line)["train/loss"] for line in (tmp_path / "run" / "progress.jsonl").read_text().splitlines()]
    assert losses[-1] < losses[-2]  # the last fit is longer, on nearly the same states


@pytest.mark.slow
def test_a_policy_learns_to_race_from_the_fastest_laps(settings, teacher, tmp_path, monkeypatch):
    monkeypatch.setattr("racerl.train.algorithms.imitation.find_teacher", lambda build: teacher)  # found once
    _, laps, crashed = learns(settings, tmp_path / "run")
    assert crashed < 0.15 and laps > 10.0 / (1.3 * FLOOR)


def test_a_policy_that_hardly_moves_does_not(settings, taught, tmp_path):
    frozen = {**settings, "algo": {**settings["algo"], "rounds": 2, "last_updates": 50, "learning_rate": 1e-9}}
    train(frozen, tmp_path / "run")
    assert driven(settings, tmp_path / "run")[1] > 0.9


def test_an_interrupted_imitation_goes_on_bit_for_bit(settings, taught, tmp_path, monkeypatch):
    brief = {"rounds": 6, "cars": 32, "updates": 3, "last_updates": 6, "batch": 64, "layers": [16], "examined_every": 2}
    short = {**settings, "algo": {**settings["algo"], **brief}}
    train(short, tmp_path / "whole")
    monkeypatch.setattr(session, "CHECKPOINT_PERIOD", 0.0)
    pull = pull_at(2 * 32 * 40, 5 * 32 * 40)
    for _ in range(2):
        with pytest.raises(Plug):
            train(short, tmp_path / "pulled", pull)
    train(short, tmp_path / "pulled")
    assert logged(tmp_path / "pulled") == logged(tmp_path / "whole") and len(logged(tmp_path / "whole")) == 6
    one, other = ((tmp_path / run / "policy.safetensors").read_bytes() for run in ("pulled", "whole"))
    assert one == other


@pytest.mark.parametrize("change", [{"rounds": 0}, {"cars": 1.5}, {"learning_rate": 0.0}, {"fast_starts": 2.0}])
def test_impossible_settings_are_told(settings, change):
    with pytest.raises(ConfigError, match="allowed"):
        create_algorithm({**settings["algo"], **change})


NUMBERS = [field.name for field in dataclasses.fields(Imitation)]


@pytest.mark.parametrize("name", NUMBERS)
def test_every_number_stands_in_its_file(settings, name):
    assert set(settings["algo"]) == {"name", *NUMBERS}
    for nonsense in (-1, float("nan"), "word", None, []):
        with pytest.raises(ConfigError, match=rf"algo\.{name} = .*(allowed|expected)") as error:
            create_algorithm({**settings["algo"], name: nonsense})
        assert "\n" not in str(error.value)
    with pytest.raises(ConfigError, match=f"{name} is missing"):  # nothing stands in for it
        create_algorithm({key: value for key, value in settings["algo"].items() if key != name})


@pytest.mark.slow
def test_within_four_percent_of_the_optimum(tmp_path):
    facts = train(compose_settings("train", ["algo=imitation", "+dr=friction_0.02"]), tmp_path / "run")
    unlimited = compose_settings("train", ["dr=none", "sim.max_steps=1000000"])
    race = build_race(unlimited, cars=3, seeds=[0, 1, 2], termination=Crash())
    laps = score(drive(race, load_policy(tmp_path / "run"), 20))
    print(facts["seconds"], laps)
    assert laps["crash_share"] == 0 and laps["mean_lap_s"] < 1.04 * FLOOR
