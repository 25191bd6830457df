"""The course of a drive: practice, counted laps, crashes, and the delta to the best lap."""

import numpy as np
import pytest

from racerl.drive.session import Phase, Session

LENGTH, DT = 10.0, 0.02


def make(laps=3, travelled=9.0):
    return Session(LENGTH, DT, laps, travelled)


class Car:
    """Moves along the track at given speeds and tells the session."""

    def __init__(self, session, travelled=9.0):
        self.session, self.travelled = session, travelled

    def drive(self, metres, speed, margin=0.1):
        for _ in range(round(metres / speed / DT)):
            before, self.travelled = self.travelled, self.travelled + speed * DT
            self.session.update(before, self.travelled, margin, False, self.travelled)

    def crash(self, restart):
        before, self.travelled = self.travelled, restart
        self.session.update(before, before + 0.01, -0.3, True, restart)


def test_only_laps_after_the_start_count_and_the_last_ends_it():
    session = make(laps=2)
    car = Car(session)
    car.drive(26.0, 2.0)
    assert len(session.driven) == 2 and session.counted == [] and session.lap == 0
    session.count(car.travelled)
    assert session.phase is Phase.COUNTED and session.elapsed is None and session.lap == 0
    car.drive(8.0, 2.0)
    assert session.counted == [] and session.lap == 1
    car.drive(10.0, 2.0)
    assert [lap.time_s for lap in session.counted] == pytest.approx([5.0]) and session.lap == 2
    assert session.phase is Phase.COUNTED
    car.drive(10.0, 2.5)
    assert [lap.time_s for lap in session.counted] == pytest.approx([5.0, 1.5 + 2.8])
    assert session.phase is Phase.FINISHED and not session.moves(1.0)


def test_the_delta_is_the_time_lost_at_the_same_place():
    session = make()
    car = Car(session)
    car.drive(1.0, 2.0)
    assert session.delta is None  # nothing to compare with
    car.drive(5.0, 1.0)
    car.drive(5.0, 5.0)  # a lap of 6 s, slow first
    car.drive(2.5, 2.0)
    assert session.best.time_s == pytest.approx(6.0)
    assert session.elapsed == pytest.approx(1.25, abs=DT) and session.delta == pytest.approx(1.25 - 2.5, abs=0.03)
    car.drive(2.5, 0.5)
    assert session.delta == pytest.approx(6.25 - 5.0, abs=0.03)
    car.drive(2.5, 2.0)
    assert session.delta == pytest.approx(7.5 - 5.5, abs=0.03)
    car.drive(2.6, 2.0)
    assert session.last.time_s == pytest.approx(8.75) and session.best.time_s == pytest.approx(6.0)


def test_at_equal_speed_the_delta_vanishes_up_to_the_line():
    session = make()
    car = Car(session)
    car.drive(11.05, 1.3)
    deltas = []
    while len(session.driven) < 2:
        car.drive(0.026, 1.3)
        deltas.append(session.delta)
    assert len(deltas) > 300 and np.abs(deltas).max() < 1e-9


def test_a_lap_off_the_track_is_no_best():
    session = make()
    car = Car(session)
    car.drive(6.0, 2.0)
    car.drive(1.0, 2.0, margin=-0.05)
    car.drive(5.0, 2.0)
    assert session.last.time_s == pytest.approx(5.0) and not session.last.valid
    assert session.best is None and session.delta is None


def test_a_crash_costs_the_lap_and_the_car_waits():
    session = make(laps=3)
    car = Car(session)
    session.count(car.travelled)
    assert session.moves(1.0)
    car.crash(9.2)  # on the way to the first line
    assert [lap.crashed for lap in session.counted] == [True] and session.standing
    assert not session.moves(0.0) and not session.moves(-1.0) and session.moves(0.3) and session.moves(0.0)
    car.drive(5.0, 2.0)
    assert session.lap == 2
    car.crash(4.0)
    assert session.last.crashed and session.last.time_s is None and session.elapsed is None and session.delta is None
    car.drive(16.5, 2.0)
    assert [lap.crashed for lap in session.counted] == [True, True, False]
    assert session.counted[-1].time_s == pytest.approx(5.0) and session.phase is Phase.FINISHED


def test_a_pause_holds_the_car_and_keeps_its_stand():
    session = make()
    session.paused = True
    assert not session.moves(1.0) and session.standing
    session.paused = False
    assert session.moves(1.0)
    session.paused = True
    assert not session.moves(1.0)


def test_rolling_back_over_the_line_spoils_no_delta():
    session = make()
    car = Car(session)
    car.drive(11.5, 2.0)
    delta = session.delta
    for step in (-0.2, -0.2, -0.4):
        before, car.travelled = car.travelled, car.travelled + step
        session.update(before, car.travelled, 0.1, False, car.travelled)
    assert session.delta == delta and np.isfinite(delta)
