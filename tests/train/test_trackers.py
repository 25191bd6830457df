"""Trackers: they are given what TensorBoard is given, once, and change nothing of a run."""

import socket
import sqlite3
import sys

import numpy as np
import pytest
from stable_baselines3.common.logger import KVWriter
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from racerl.config import compose_settings
from racerl.errors import ConfigError
from racerl.rerun import rerun
from racerl.run import CONFIG, RunFolder
from racerl.train import onward, session, train
from racerl.train.trackers import create_tracker, trackio
from tests.train.pulled import Plug, pull_at
from tests.train.short import refinement

WORDS = ["budget=smoke", "threads=1", "dr=friction_0.02"]
TRACKED = [*WORDS, "tracking=trackio"]


class Memory(KVWriter):
    """Stands in for a tracker; remembers the runs that it was to follow, and the steps of what it was given."""

    def __init__(self):
        self.runs, self.steps = [], []

    def follow(self, folder):
        self.runs.append(folder.manifest["run_id"])
        return self

    def write(self, key_values, key_excluded, step=0):
        self.steps.append(step)

    def close(self):
        pass


@pytest.fixture
def memory(monkeypatch):
    kept = Memory()
    monkeypatch.setattr(train, "create_tracker", lambda settings: kept if settings else None)
    return kept


@pytest.fixture
def storage(tmp_path, monkeypatch):
    """Trackio's database in a folder of its own, on a machine that reaches no other."""
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    pytest.importorskip("trackio", reason="Trackio is an extra: pip install -e '.[tracking]'")
    from trackio import sqlite_storage

    def refuse(*arguments):
        raise AssertionError(f"tracking reached for the network: {arguments[1:]}")

    monkeypatch.setattr(sqlite_storage, "TRACKIO_DIR", tmp_path / "trackio")
    for name in ("connect", "connect_ex", "sendto"):
        monkeypatch.setattr(socket.socket, name, refuse)
    monkeypatch.setattr("builtins.input", refuse)
    return sqlite_storage.SQLiteStorage


def tracked(storage, name):
    """Return every number of a tracked run with its name and step, in order."""
    return sorted(
        (key, row["step"], np.float32(value))
        for row in storage.get_logs("racerl", name)
        for key, value in row.items()
        if key not in ("step", "timestamp")
    )


def in_tensorboard(run):
    events = EventAccumulator(str(run / "tensorboard")).Reload()
    tags = events.Tags()["scalars"]
    return sorted((tag, each.step, np.float32(each.value)) for tag in tags for each in events.Scalars(tag))


def without_clock(numbers):
    return [number for number in numbers if not number[0].startswith("time/")]


def test_tracking_is_no_part_of_a_run(smoke_run, memory, tmp_path):
    out = tmp_path / "run"
    train.train(compose_settings("train", TRACKED), out)
    assert memory.steps == [1024, 2048, 2048]  # the last update and examination as well
    assert (out / "policy.safetensors").read_bytes() == (smoke_run / "policy.safetensors").read_bytes()
    assert "tracking" not in (out / CONFIG).read_text()
    one, other = (RunFolder.open_complete(run).manifest["config_hash"] for run in (out, smoke_run))
    assert one == other
    assert rerun({"run": str(out)}, tmp_path / "again", compose_settings)["same"] and len(memory.runs) == 1


def test_a_run_goes_on_with_another_tracker(memory, tmp_path, monkeypatch):
    monkeypatch.setattr(session, "CHECKPOINT_PERIOD", 0.0)
    for words in (TRACKED, WORDS):
        with pytest.raises(Plug):
            train.train(compose_settings("train", words), tmp_path / "run", pull_at(1024))
    train.train(compose_settings("train", TRACKED), tmp_path / "run")
    assert len(memory.runs) == 2 and len(set(memory.runs)) == 1


def test_what_is_refined_onward_is_tracked_where_it_is_asked_for(smoke_run, memory, tmp_path):
    words = [f"from='{smoke_run}'", "budget=smoke", refinement(), "threads=1"]
    for name, more in (("plain", []), ("tracked", ["tracking=trackio"])):
        onward.train_onward(compose_settings("refine", [*words, *more]), tmp_path / name)
    assert memory.runs == [RunFolder.open_complete(tmp_path / "tracked").manifest["run_id"]] and memory.steps


def test_where_the_extra_is_missing_a_line_says_what_to_do(tmp_path, monkeypatch):
    for name in ("trackio", "trackio.sqlite_storage"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(ConfigError, match=r"tracking=trackio needs trackio.* pip install -e '\.\[tracking\]'"):
        train.train(compose_settings("train", TRACKED), tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_what_is_no_tracker_is_said_in_one_line():
    for wrong, said in (("trackio", "a mapping with a name"), ({"name": "trakio"}, "did you mean trackio")):
        with pytest.raises(ConfigError, match=said):
            create_tracker(wrong)


def test_trackio_has_the_numbers_that_tensorboard_has(storage, tmp_path):
    words = [*TRACKED, refinement()]
    train.train(compose_settings("train", words), tmp_path / "run")
    seen = tracked(storage, "run")
    assert seen == in_tensorboard(tmp_path / "run") and len(seen) > 30
    (record,) = storage.get_run_records("racerl")
    assert record["id"] == RunFolder.open_complete(tmp_path / "run").manifest["run_id"]


def test_a_resumed_training_goes_on_in_the_same_tracked_run(storage, smoke_run, tmp_path, monkeypatch):
    words = [*TRACKED, "budget.steps=6144"]
    train.train(compose_settings("train", words), tmp_path / "whole")
    pull = pull_at(1024, 2048, 4096)
    for period in (1e6, 0.0, 0.0):  # before its first checkpoint, and behind others
        monkeypatch.setattr(session, "CHECKPOINT_PERIOD", period)
        with pytest.raises(Plug):
            train.train(compose_settings("train", words), tmp_path / "pulled", pull)
    train.train(compose_settings("train", words), tmp_path / "pulled")
    whole, pulled = (tracked(storage, name) for name in ("whole", "pulled"))
    assert without_clock(whole) == without_clock(pulled) and len(storage.get_run_records("racerl")) == 2
    one, other = ((tmp_path / run / "policy.safetensors").read_bytes() for run in ("whole", "pulled"))
    assert one == other


def test_a_database_that_fails_stops_no_training(storage, smoke_run, tmp_path, monkeypatch, caplog):
    def full(**record):
        raise sqlite3.OperationalError("database or disk is full")

    monkeypatch.setattr(storage, "bulk_log", full)
    train.train(compose_settings("train", TRACKED), tmp_path / "run")
    assert caplog.text.count("tracking=trackio: database or disk is full; the training goes on without") == 1
    assert (tmp_path / "run" / "policy.safetensors").read_bytes() == (smoke_run / "policy.safetensors").read_bytes()


@pytest.mark.parametrize(
    "project, said", [("''", "letters, digits"), ("../x", "letters, digits"), ("x_system", "not allowed")]
)
def test_a_project_has_a_name_of_its_own(project, said, storage, tmp_path):
    with pytest.raises(ConfigError, match=said):
        train.train(compose_settings("train", [*TRACKED, f"tracking.project={project}"]), tmp_path / "run")
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(("path", "name"), [("none-0-2c2358/train", "none-0-2c2358"), ("first", "first")])
def test_the_training_of_a_sweeps_job_has_the_jobs_name(path, name, monkeypatch, tmp_path):
    monkeypatch.setattr(trackio, "_storage", lambda: None)
    assert trackio.Records("racerl", RunFolder.start(tmp_path / path, "train", {"seed": 0})).name == name
