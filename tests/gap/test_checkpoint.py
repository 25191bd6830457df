"""An interrupted `racerl gap` goes on behind its finished fits to the same bytes, and reads nothing but its own."""

import shutil
from concurrent.futures import CancelledError
from dataclasses import replace
from threading import Event
from types import SimpleNamespace

import numpy as np
import pytest

from racerl.config import compose_settings
from racerl.data.load import load_given
from racerl.errors import RunError
from racerl.gap.checkpoint import FOLDER, Checkpoint
from racerl.gap.cross_validation import held_out
from racerl.gap.diagnose import cut, gap, refit
from racerl.gap.evidence import Evidence
from racerl.gap.noise import noise_cost
from racerl.gap.problem import Problem
from racerl.gap.stage import STEERING
from racerl.gap.stage_problem import StageProblem
from racerl.gap.uncertainty import deviations
from racerl.gap.workers import Workers
from racerl.vehicle import catalogue
from racerl.vehicle import compiler as building
from racerl.vehicle.load import load_vehicle
from tests.gap.conftest import drive
from tests.vehicle.conftest import make_car

needs_compiler = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler on this machine")
KNOWN = ("steering_delay", "steering_gain", "drive_delay")
MOTION = ["x", "y", "yaw", "v_x", "v_y", "yaw_rate"]
WRITTEN = ("verdict.json", "locate.json", "name.json", "prove.json", "model.yaml", "model_before.yaml")


def interrupted(at):
    """Return what hears a diagnosis' progress, and is Ctrl-C at one of its reports."""
    heard = []

    def on_progress(what, share):
        heard.append((what, share))
        if len(heard) == at:
            raise KeyboardInterrupt

    return on_progress, heard


def counted(patch):
    """Return a list that grows by every fit."""
    fits, whole = [], Problem.fit

    def fit(*arguments, **options):
        fits.append(arguments)
        return whole(*arguments, **options)

    patch.setattr(Problem, "fit", fit)
    return fits


@pytest.fixture(scope="module")
def steered(tmp_path_factory):
    """A log of commands and actuators alone, whose diagnosis takes a second, and what comes of that."""
    folder = tmp_path_factory.mktemp("steered")
    log = drive("+vehicle/effect=steering_delay", seconds=25.0)
    log.table.drop(columns=MOTION).to_parquet(folder / "log.parquet", index=False)
    without = [name for name in catalogue.names() if name not in KNOWN]
    words = [f"logs=['{folder / 'log.parquet'}']", "vehicle=published", "window=40", "folds=3"]
    settings = {**compose_settings("gap", words), "without": without}
    listener, heard = interrupted(None)
    with pytest.MonkeyPatch.context() as patch:
        fits = counted(patch)
        facts = gap(settings, folder / "out", listener)
    assert facts["verdict"] == "named"
    return SimpleNamespace(settings=settings, out=folder / "out", heard=heard, fits=len(fits))


@pytest.fixture(scope="module")
def stopped(steered, tmp_path_factory):
    """The same, interrupted three times; `kept` are the finished parts after each, `fits` all that were made."""
    out, kept = tmp_path_factory.mktemp("stopped") / "out", []
    with pytest.MonkeyPatch.context() as patch:
        fits = counted(patch)
        for at in (2, 4, len(steered.heard)):  # where errors are, in the midst of naming, and ahead of the proof
            with pytest.raises(KeyboardInterrupt):
                gap(steered.settings, out, interrupted(at)[0])
            kept.append(len(list((out / FOLDER).glob("*/*"))))
    return SimpleNamespace(out=out, kept=kept, fits=len(fits))


@needs_compiler
def test_an_interrupted_diagnosis_goes_on_to_the_same_bytes(steered, stopped, tmp_path, monkeypatch):
    assert 0 < stopped.kept[0] < stopped.kept[1] < stopped.kept[2]
    assert not (stopped.out / "verdict.json").exists()
    out, fits = shutil.copytree(stopped.out, tmp_path / "out"), counted(monkeypatch)
    gap(steered.settings, out)
    for name in WRITTEN:
        assert (out / name).read_bytes() == (steered.out / name).read_bytes(), name
    assert len(fits) <= 3  # the proof's own, and two whose derivatives it needs
    assert stopped.fits + len(fits) < 1.5 * steered.fits
    assert not (out / FOLDER).exists() and not (steered.out / FOLDER).exists()


@needs_compiler
def test_parts_that_are_damaged_or_another_s_are_worked_out_again(steered, stopped, tmp_path, monkeypatch, caplog):
    out = shutil.copytree(stopped.out, tmp_path / "out")
    first, second, third, *_ = sorted((out / FOLDER).glob("*/*"), key=lambda path: -path.stat().st_size)
    content = first.read_bytes()
    first.write_bytes(second.read_bytes())  # whole, but another's
    second.write_bytes(content[: len(content) // 2])
    third.write_bytes(third.read_bytes()[:-1] + b"\xff")
    fits = counted(monkeypatch)
    gap(steered.settings, out)
    assert sorted(record.getMessage() for record in caplog.records) == sorted(
        f"{path}: is damaged; what it held is worked out again" for path in (first, second, third)
    )
    assert len(fits) <= 6
    assert (out / "verdict.json").read_bytes() == (steered.out / "verdict.json").read_bytes()


@needs_compiler
def test_what_judging_asks_of_a_finished_fit_needs_no_fit_again(steered, tmp_path, monkeypatch):
    logs = load_given(steered.settings)
    evidence = cut(logs, steered.settings)

    def asked():
        checkpoint = Checkpoint.of(tmp_path, steered.settings, evidence)
        vehicle = load_vehicle(steered.settings["vehicle"])
        investigation = refit(evidence, logs, vehicle, steered.settings, checkpoint)
        base = investigation.base
        cost = {name: part.tolist() for name, part in held_out(investigation, base).items()}
        return base.theta, deviations(investigation, base), cost, noise_cost(investigation, base, 0)

    first, fits = asked(), counted(monkeypatch)
    assert asked() == first and not fits


@needs_compiler
def test_the_progress_only_goes_forward_and_goes_on_behind_the_screening(steered):
    shares = [share for _, share in steered.heard]
    assert shares == sorted(shares) and shares[0] == 0.0 and shares[-1] < 1.0
    assert [what for what, _ in steered.heard].count("name: steering_delay") == 3  # screened, fitted, to its end


@needs_compiler
def test_a_checkpoint_of_other_logs_or_another_racerl_is_passed_over(steered, tmp_path, monkeypatch, caplog):
    (log,) = load_given(steered.settings)
    evidence = cut([log], steered.settings)
    mine = Checkpoint.of(tmp_path, steered.settings, evidence)
    key = mine.key("fit", np.arange(3.0), {"yaw_inertia": 0.1})
    assert key != mine.key("fit", np.arange(3), {"yaw_inertia": 0.1})  # other numbers, for a computer
    mine.keep(key, {"theta": np.array([0.1, np.nan])})
    turned = {name: replace(each, columns=dict([*each.columns.items()][::-1])) for name, each in evidence.items()}
    for same in (evidence, turned):  # the channels are a set, whose order another process has otherwise
        kept = Checkpoint.of(tmp_path, steered.settings, same).find(key)
        np.testing.assert_array_equal(kept["theta"], [0.1, np.nan])
    assert not caplog.records
    table = log.table.copy()
    table.loc[100, "delta"] += 1e-9
    changed = cut([replace(log, table=table)], steered.settings)
    assert Checkpoint.of(tmp_path, steered.settings, changed).find(key) is None
    monkeypatch.setattr("racerl.gap.checkpoint.provenance", lambda: {"git_sha": "another"})
    assert Checkpoint.of(tmp_path, steered.settings, evidence).find(key) is None
    assert [record.getMessage() for record in caplog.records] == [
        f"{tmp_path / FOLDER}: belongs to other logs, another racerl or another machine; it is not used"
    ] * 2


def test_an_input_that_has_no_content_is_no_key():
    with pytest.raises(TypeError, match="set has no content to hash"):
        Checkpoint().key({"delta"})


def test_a_checkpoint_that_cannot_be_written_says_so(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(RunError, match=r"cannot be written .*; give another out="):
        Checkpoint(tmp_path / "file" / "folder").keep("key", {"theta": np.zeros(1)})


def test_other_threads_end_before_their_next_fit():
    workers = Workers(2)
    begun, asked = [], Event()

    def candidate(item):
        begun.append(item)
        if item:
            asked.wait(5.0)
            workers.go_on()
        return item

    def ctrl_c(item, share):
        asked.set()
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        workers.each(candidate, range(50), ctrl_c)
    assert len(begun) < 5
    with pytest.raises(CancelledError):
        workers.go_on()


def test_a_compiler_that_the_user_interrupts_is_no_broken_compiler(tmp_path, monkeypatch):
    compiler = tmp_path / "cc"
    compiler.write_text('#!/bin/sh\n[ "$1" = --version ] || kill -INT $$\n')
    compiler.chmod(0o755)
    monkeypatch.setattr(building, "find_compiler", lambda: str(compiler))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    with pytest.raises(KeyboardInterrupt):
        building.build("int nothing;")


def test_a_fit_of_other_windows_of_the_same_rows_has_another_key(clean):
    whole = Evidence.of([clean], STEERING, 80, 0.5)
    kernel = SimpleNamespace(catalogue={}, rollout=SimpleNamespace(names=[]))
    cuts = [whole, whole.parted(40), whole.parted(20), replace(whole, start=whole.start + 1)]
    told = [StageProblem(cut, kernel, make_car(), (), np.ones(1)).told() for cut in (*cuts, whole)]
    keys = [Checkpoint.key(each) for each in told]
    assert len(set(keys)) == 4 and keys[-1] == keys[0]
