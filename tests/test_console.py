"""The bar goes forward only, and the time left follows from the whole of what was done."""

import io

import pytest
from rich.console import Console

from racerl import console
from racerl.console import Bar, Left, clock
from racerl.vehicle import compiler


@pytest.fixture
def now(monkeypatch):
    """A clock that a test turns."""
    time = [0.0]
    monkeypatch.setattr(console.time, "monotonic", lambda: time[0])
    return time


def test_the_bar_never_shows_less_than_before(now):
    stream = io.StringIO()
    with Bar(Console(file=stream), "identify") as bar:
        for share in (0.1, 0.82, 0.04, 0.9):
            bar.show(share, "")
            now[0] += 60.0
    assert [line.split()[1] for line in stream.getvalue().splitlines()] == ["10%", "82%", "82%", "90%"]


def test_a_live_bar_never_shows_less_either():
    with Bar(Console(file=io.StringIO(), force_terminal=True), "identify") as bar:
        bar.show(0.82, "fit")
        bar.show(0.04, "held-out runs")
        assert bar._progress.tasks[0].completed == 0.82


def test_the_bar_says_what_it_waits_for_and_stays_where_it_is(monkeypatch):
    heard = []
    monkeypatch.setattr(compiler, "_listeners", heard)
    with Bar(Console(file=io.StringIO(), force_terminal=True), "gap") as bar:
        bar.show(0.3, "locate")
        heard[0]()
        task = bar._progress.tasks[0]
        assert (task.completed, task.fields["remark"]) == (0.3, "compiling for this machine, once")
    assert not heard


def test_the_time_left_follows_the_mean_pace(now):
    left = Left()
    left.hear(0.5)  # resumed: this half was another run's
    assert left.seconds() is None
    now[0] = 100.0
    left.hear(0.75)
    assert left.seconds() == pytest.approx(100.0)
    now[0] = 110.0  # nothing new: it grows slowly, and does not jump
    assert left.seconds() == pytest.approx(110.0)
    left.hear(0.8, told=7.0)
    assert left.seconds() == 7.0


def test_clock():
    assert [clock(s) for s in (0.4, 61, 3725)] == ["0:00", "1:01", "1:02:05"]
