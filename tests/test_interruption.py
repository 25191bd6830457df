"""Asked to stop: work is kept first, a second request leaves at once, what is ignored stays ignored."""

import logging
import os
import signal
import subprocess
import sys
import threading
import time

import casadi
import numpy as np
import pytest

from racerl.interruption import Terminated, _end, behind, held_back, listen, not_swallowed
from racerl.optimum.collocation import minimise

CODE = """
import sys
from racerl.train import session
session.CHECKPOINT_PERIOD = 1e6
from racerl.cli import main
sys.argv = ["racerl", "train", "budget=smoke", "threads=1", "budget.steps=300000", "out=" + sys.argv[1]]
main()
"""


@pytest.fixture(autouse=True)
def handlers():
    """Put the handlers back that were there."""
    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGINT)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ends_a_command_as_ctrl_c_does(number):
    listen()
    with pytest.raises(KeyboardInterrupt) as stop:
        os.kill(os.getpid(), number)
        time.sleep(1.0)
    assert isinstance(stop.value, Terminated) and stop.value.number == number


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_the_first_is_held_back_until_work_is_kept(number, caplog):
    listen()
    kept = []
    with pytest.raises(KeyboardInterrupt), held_back() as asked:
        asked.release()  # nothing has come
        os.kill(os.getpid(), number)
        time.sleep(0.01)
        assert asked
        kept.append("work")
        asked.release()
        kept.append("never")
    assert kept == ["work"] and "ask again to leave at once" in caplog.text


def test_a_library_that_swallows_it_does_not_keep_it():
    listen()
    kept = []
    with pytest.raises(Terminated) as stop, not_swallowed():
        try:
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(1.0)
        except KeyboardInterrupt:
            kept.append("asked")  # and the library returns as if nothing had been
    assert kept == ["asked"] and stop.value.number == signal.SIGTERM
    assert signal.getsignal(signal.SIGTERM) is _end
    with not_swallowed():
        pass


def test_ipopt_that_is_asked_to_stop_is_no_failed_problem():
    """CasADi ends ipopt then, and goes on."""
    listen()
    x, start = casadi.MX.sym("x", 3000), np.full(3000, -1.2)
    cost = casadi.sum1(100.0 * (x[1:] - x[:-1] ** 2) ** 2 + (1.0 - x[:-1]) ** 2)  # 500 iterations in vain
    threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGTERM)).start()
    with pytest.raises(Terminated):
        minimise(cost, x, casadi.MX(0, 1), start, start - 9.0, start + 9.0)


def test_a_library_that_raises_something_else_was_interrupted_all_the_same():
    try:
        try:
            raise Terminated(signal.SIGTERM)
        except Terminated as stop:
            raise SystemError("returned a result with an exception set") from stop
    except SystemError as error:
        assert isinstance(behind(error), Terminated)
    assert behind(ValueError("nobody asked")) is None


@pytest.mark.parametrize(
    ("words", "where", "how"),
    [
        (["gap", "log.csv"], "racerl.gap.diagnose.gap", "continues"),
        (["gap", "plan"], "racerl.gap.plan.plan", "continues"),
        (["gap", "close", "log.csv", "real=log.csv"], "racerl.train.close.close", "continues"),
        (["train"], "racerl.train.train.train", "continues"),
        (["train", "from=RUN"], "racerl.train.onward.train_onward", "continues"),
        (["sweep", "ablations"], "racerl.sweep.sweep.sweep", "continues"),
        (["identify", "log.csv"], "racerl.identify.identify.identify", "begins again"),
        (["record"], "racerl.cli._console", "begins again"),  # while libraries load
    ],
)
def test_how_to_go_on_is_said(run, monkeypatch, tmp_path, words, where, how):
    def ctrl_c(*arguments, **named):
        raise KeyboardInterrupt

    (tmp_path / "log.csv").touch()
    monkeypatch.setattr(where, ctrl_c)
    ended = run(*words, "out=outputs/mine")
    assert ended.returncode == 130
    assert ended.stdout.splitlines()[-1] == f"interrupted; the same command with out=outputs/mine {how}"


def test_the_second_leaves_at_once():
    kept = []
    with pytest.raises(KeyboardInterrupt), held_back():
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.01)
        kept.append("one")
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(1.0)
        kept.append("two")
    assert kept == ["one"]


def test_one_that_came_too_late_to_be_looked_at_is_not_lost():
    with pytest.raises(KeyboardInterrupt), held_back():
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.01)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_what_is_ignored_stays_ignored():
    signal.signal(signal.SIGHUP, signal.SIG_IGN)  # as under nohup
    listen()
    with held_back() as asked:
        os.kill(os.getpid(), signal.SIGHUP)
        time.sleep(0.01)
        assert not asked
    assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN


def test_it_works_outside_the_main_thread():
    from concurrent.futures import ThreadPoolExecutor

    def work():
        with held_back() as asked:
            asked.release()
            return bool(asked)

    with ThreadPoolExecutor(1) as pool:
        assert pool.submit(work).result() is False


@pytest.mark.parametrize("number", [signal.SIGTERM, pytest.param(signal.SIGINT, marks=pytest.mark.slow)])
def test_a_training_keeps_a_checkpoint_and_ends_soon(number, tmp_path):
    out = tmp_path / "run"
    job = subprocess.Popen([sys.executable, "-c", CODE, str(out)], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    log, deadline = out / "progress.jsonl", time.monotonic() + 90
    while not (log.exists() and log.read_text().count("\n") >= 3) and time.monotonic() < deadline:
        time.sleep(0.05)
    job.send_signal(number)
    asked = time.monotonic()
    told, warned = job.communicate(timeout=30)
    assert time.monotonic() - asked < 10.0
    assert job.returncode == 128 + number
    assert (out / "checkpoint.safetensors").is_file()
    assert f"the same command with out={out} continues" in told.decode().replace("\n", " ")
    assert "Traceback" not in warned.decode()


def test_the_log_says_so_in_one_line(caplog):
    with caplog.at_level(logging.WARNING), pytest.raises(KeyboardInterrupt), held_back():
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.01)
    assert len(caplog.records) == 1


def test_another_signal_leaves_at_once_as_the_same_one_does():
    listen()
    kept = []
    with pytest.raises(Terminated) as stop, held_back():
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.01)
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(0.5)
        kept.append("never")
    assert not kept and stop.value.number == signal.SIGTERM


def test_what_a_cluster_sends_beside_is_no_second_request():
    listen()
    kept = []
    with pytest.raises(Terminated), held_back() as asked:
        os.kill(os.getpid(), signal.SIGTERM)
        os.kill(os.getpid(), signal.SIGHUP)
        time.sleep(0.01)
        kept.append("work")
        asked.release()
    assert kept == ["work"]


def test_a_signal_is_not_lost_where_the_loop_fails():
    listen()
    with pytest.raises(KeyboardInterrupt) as stop, held_back():
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.01)
        raise RuntimeError("diverged")
    assert isinstance(stop.value.__context__, RuntimeError)
