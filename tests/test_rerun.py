"""A run done again: the same comes out, what does not is named, and what cannot be done again is one line."""

import json
import shutil

import pytest
import yaml

from racerl.config import compose_settings
from racerl.errors import RacerlError
from racerl.evaluate.evaluate import evaluate
from racerl.record.record import record
from racerl.rerun import rerun
from racerl.run import RunFolder


def again(run, out):
    return rerun(compose_settings("rerun", [f"run={run}", f"out={out}"]), out, compose_settings)


def test_a_training_comes_out_the_same(smoke_run, tmp_path):
    facts = again(smoke_run, tmp_path / "again")
    assert facts["same"] and not facts["differences"]
    assert facts["files"] == ["policy.json", "policy.safetensors", "progress.jsonl"]
    with pytest.raises(RacerlError, match="already holds this very run"):
        again(smoke_run, tmp_path / "again")


def test_other_stages_come_out_the_same(smoke_run, tmp_path):
    evaluate(compose_settings("evaluate", [f"run={smoke_run}", "laps=1", "seeds=[0,1]"]), tmp_path / "raced")
    record(compose_settings("record", ["seconds=30", "drive=race"]), tmp_path / "driven")
    assert again(tmp_path / "raced", tmp_path / "1")["files"] == ["metrics.json", "track.csv", "trajectories.parquet"]
    assert again(tmp_path / "driven", tmp_path / "2")["same"]


@pytest.fixture
def copy(smoke_run, tmp_path):
    shutil.copytree(smoke_run, tmp_path / "copy")
    return tmp_path / "copy"


def change(path, old, new):
    content = path.read_bytes()
    assert old in content
    path.write_bytes(content.replace(old, new, 1))


def test_what_is_no_longer_the_same_is_told(copy, tmp_path):
    weights = copy / "policy.safetensors"
    weights.write_bytes(weights.read_bytes()[:-1] + b"\x07")
    facts = json.loads((copy / "policy.json").read_text())
    facts["evaluation"]["laps"] += 1
    facts["seconds"] = -1.0  # the clock's
    (copy / "policy.json").write_text(json.dumps(facts))
    lines = (copy / "progress.jsonl").read_text().splitlines()
    last = {**json.loads(lines[-1]), "train/reward": 7.0}
    (copy / "progress.jsonl").write_text("\n".join([*lines[:-1], json.dumps(last)]) + "\n")
    (copy / "extra.csv").write_text("1")
    found = again(copy, tmp_path / "again")
    told = {each["file"]: each["what"] for each in found["differences"]}
    laps = facts["evaluation"]["laps"]
    assert told == {
        "policy.safetensors": "other bytes",
        "policy.json": f"evaluation.laps: {laps} → {laps - 1}",
        "progress.jsonl": f"from line {len(lines)} on",
        "extra.csv": "is not there any more",
    }
    assert json.loads((tmp_path / "again" / "rerun.json").read_text())["same"] is False


def test_what_has_changed_of_machine_and_software_is_told(copy, tmp_path):
    manifest = json.loads((copy / "manifest.json").read_text())
    (copy / "manifest.json").write_text(json.dumps({**manifest, "cpu": "an abacus", "git_sha": "abc"}))
    told = again(copy, tmp_path / "again")["changed"]
    assert any(line.startswith("cpu: an abacus then, ") for line in told) and len(told) == 2


def test_what_cannot_be_done_again_is_one_line(copy, tmp_path):
    def refused(said):
        with pytest.raises(RacerlError, match=said) as error:
            again(copy, tmp_path / "again")
        assert "\n" not in str(error.value) and not (tmp_path / "again" / "again").exists()

    settings = yaml.safe_load((copy / "config.yaml").read_text())
    (copy / "config.yaml").write_text(yaml.safe_dump({key: settings[key] for key in settings if key != "algo"}))
    refused("lacks 'algo'")
    change(copy / "manifest.json", b'"stage": "train"', b'"stage": "drive"')
    refused("a drive run is not done again; allowed are train, evaluate")
    change(copy / "manifest.json", b'"status": "complete"', b'"status": "running"')
    refused("not complete")


def test_an_interrupted_one_goes_on(smoke_run, tmp_path, monkeypatch):
    from racerl import rerun as module

    def killed(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(module, "_differences", killed)
        with pytest.raises(KeyboardInterrupt):
            again(smoke_run, tmp_path / "again")
    monkeypatch.setitem(module.STAGES, "train", killed)  # it is there already
    assert again(smoke_run, tmp_path / "again")["same"]
    assert RunFolder.open_complete(tmp_path / "again", "rerun").manifest["same"] is True
