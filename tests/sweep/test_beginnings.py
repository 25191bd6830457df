"""Trainings that differ in their ending alone: what comes before it is trained once."""

import dataclasses
from types import SimpleNamespace

import pytest
import torch

import racerl.train.train as training
from racerl.config import compose_settings
from racerl.control.policy import UNREFINED, load_policy
from racerl.documents import read_json, write_json
from racerl.run import CONFIG
from racerl.sweep.definition import read_sweeps
from racerl.sweep.jobs import begun_alike, plan
from racerl.train.train import train
from tests.train.pulled import logged
from tests.train.short import ascent, refinement

SETTINGS = {**compose_settings("sweep", ["name=learner", "laps=1", "starts=[0]"]), "cars": ["model"]}


@pytest.fixture(scope="module")
def jobs(tmp_path_factory):
    """Jobs by arm and seed, of which the first is trained."""
    arms = {"slow": (ascent(),), "fast": (ascent(price=10.0),), "evolved": (refinement(),), "plain": ()}
    arms["other"] = (ascent(), "dr=friction_0.1")
    sweep = dataclasses.replace(read_sweeps("learner")[0], base=("budget=smoke",), arms=arms, seeds=(0, 1))
    found = plan([sweep], SETTINGS, tmp_path_factory.mktemp("sweep"), compose_settings).of
    by = {(arm, seed): job for (_, arm, seed), job in found.items()}
    train(by["slow", 0].train, by["slow", 0].trained)
    return by


def test_what_begins_alike_is_found(jobs):
    first = jobs["slow", 0]
    assert begun_alike(first) is None  # itself alone
    for arm, seed, alike in (("fast", 0, True), ("evolved", 0, True), ("plain", 0, False), ("other", 0, False)):
        assert begun_alike(jobs[arm, seed]) == (first.trained if alike else None), arm
    assert begun_alike(jobs["fast", 1]) is None


def test_it_is_taken_over_to_the_same_weights(jobs, tmp_path, monkeypatch):
    job, first = jobs["fast", 0], jobs["slow", 0]
    alone = train(job.train, tmp_path / "alone")
    monkeypatch.setattr(training, "create_algorithm", lambda _: SimpleNamespace(train=None))  # not asked again
    facts = train(job.train, job.trained, begun=begun_alike(job))
    assert {**facts, "seconds": 0.0} == {**alone, "seconds": 0.0}
    assert facts["seconds"] > training.read_json(first.trained / UNREFINED / "policy.json")["seconds"]  # they count
    for part in ("", UNREFINED):
        one, other = (load_policy(run / part).network.state_dict() for run in (tmp_path / "alone", job.trained))
        assert all(torch.equal(one[name], other[name]) for name in one)
    assert logged(job.trained) == logged(tmp_path / "alone")


def test_a_file_that_has_changed_since_makes_another_beginning(jobs):
    before, job = jobs["slow", 0], jobs["evolved", 0]
    manifest = read_json(before.trained / "manifest.json")
    write_json(before.trained / "manifest.json", {**manifest, "files": {"mine.yaml": "another"}})
    assert begun_alike(job) != before.trained
    write_json(before.trained / "manifest.json", manifest)


@pytest.mark.parametrize("file", [CONFIG, f"{UNREFINED}/policy.safetensors", f"{UNREFINED}/policy.json"])
def test_a_damaged_folder_is_nobodys_beginning(file, jobs):
    before = jobs["slow", 0].trained
    kept = (before / file).read_bytes()
    (before / file).write_bytes(kept[:40])
    assert begun_alike(jobs["evolved", 0]) != before
    (before / file).write_bytes(kept)
