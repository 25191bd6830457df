"""Run folders: who may write where, and which may be read."""

import errno
import fcntl
import gc
import json
import os
import shutil
import stat
import subprocess
import sys

import pytest

from racerl.errors import RunError
from racerl.run import FORMAT, WORDS, RunFolder, config_hash, uncommitted


def test_a_run_is_started_finished_and_opened(tmp_path):
    folder = RunFolder.start(tmp_path / "a", "train", {"seed": 1, "out": "a"}, seed=1)
    with pytest.raises(RunError, match="not complete"):
        RunFolder.open_complete(tmp_path / "a")
    folder.finish(steps=3)
    opened = RunFolder.open_complete(tmp_path / "a", "train")
    assert opened.manifest["steps"] == 3 and opened.settings() == {"seed": 1, "out": "a"}
    assert {"git_sha", "cpu", "libraries", "python"} <= set(opened.manifest)


def test_an_interrupted_run_of_the_same_settings_is_continued(tmp_path):
    first = RunFolder.start(tmp_path / "a", "train", {"seed": 1})
    assert RunFolder.start(tmp_path / "a", "train", {"seed": 1}).manifest["run_id"] == first.manifest["run_id"]
    with pytest.raises(RunError, match="another"):
        RunFolder.start(tmp_path / "a", "train", {"seed": 2})
    with pytest.raises(RunError, match="another"):
        RunFolder.start(tmp_path / "a", "evaluate", {"seed": 1})


def test_two_writers_are_told_apart(tmp_path):
    code = (
        "import sys; from pathlib import Path; from racerl.run import RunFolder;"
        "run = RunFolder.start(Path(sys.argv[1]), 'train', {'seed': 1}); print('held', flush=True); sys.stdin.read()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code, str(tmp_path / "a")], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as other:
        assert other.stdout.readline() == b"held\n"
        with pytest.raises(RunError, match="another train is at work in it"):
            RunFolder.start(tmp_path / "a", "train", {"seed": 1})
        other.kill()  # its death lets go
        other.wait()
        RunFolder.start(tmp_path / "a", "train", {"seed": 1}).finish()


def held_elsewhere(path):
    """Return whether another process is told that this one is at work."""
    code = "import sys; from pathlib import Path; from racerl.run import RunFolder;"
    code += "RunFolder.start(Path(sys.argv[1]), 'train', {'seed': 1})"
    done = subprocess.run([sys.executable, "-c", code, str(path)], capture_output=True, text=True)
    return "another train is at work" in done.stderr


def test_a_folder_is_let_go_with_the_stage_that_failed_in_it(tmp_path):
    def fails():
        folder = RunFolder.start(tmp_path / "a", "train", {"seed": 1})
        assert held_elsewhere(tmp_path / "a") and folder
        raise ValueError

    with pytest.raises(ValueError):
        fails()
    gc.collect()
    assert not held_elsewhere(tmp_path / "a")


def test_a_folder_that_was_removed_and_made_anew_is_held_anew(tmp_path):
    first = RunFolder.start(tmp_path / "a", "train", {"seed": 1})
    shutil.rmtree(tmp_path / "a")
    second = RunFolder.start(tmp_path / "a", "train", {"seed": 1})
    assert first.manifest["run_id"] != second.manifest["run_id"]
    assert held_elsewhere(tmp_path / "a")
    second.finish()


def test_where_no_folder_can_be_locked_a_file_is(tmp_path, monkeypatch):
    lock = fcntl.flock

    def as_on_nfs(handle, how):
        if stat.S_ISDIR(os.fstat(handle if isinstance(handle, int) else handle.fileno()).st_mode):
            raise OSError(errno.EBADF, "Bad file descriptor")
        lock(handle, how)

    monkeypatch.setattr(fcntl, "flock", as_on_nfs)
    folder = RunFolder.start(tmp_path / "a", "train", {"seed": 1})
    with (tmp_path / "a" / ".lock").open("a") as other, pytest.raises(BlockingIOError):
        lock(other, fcntl.LOCK_EX | fcntl.LOCK_NB)
    folder.finish()
    assert {path.name for path in (tmp_path / "a").iterdir()} == {"manifest.json", "config.yaml"}


def test_a_folder_that_is_refused_is_left_as_it_was(tmp_path):
    (tmp_path / "precious.txt").write_text("mine")
    with pytest.raises(RunError, match="not empty"):
        RunFolder.start(tmp_path, "train", {"seed": 1})
    assert [path.name for path in tmp_path.iterdir()] == ["precious.txt"]


def test_a_run_that_was_killed_while_its_manifest_was_written_begins_anew(tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / ".manifest.json.xyz.tmp").write_text('{"form')
    assert RunFolder.start(tmp_path / "a", "train", {"seed": 1}).manifest["status"] == "running"
    (tmp_path / "a" / "config.yaml").unlink()  # killed behind the manifest
    assert RunFolder.start(tmp_path / "a", "train", {"seed": 1}).settings() == {"seed": 1}


def test_a_manifest_knows_the_words_and_what_is_not_committed(tmp_path, monkeypatch):
    assert RunFolder.start(tmp_path / "a", "train", {}).manifest["words"] is None
    token = WORDS.set(("dr=friction_0.02", "seed=3"))
    try:
        assert RunFolder.start(tmp_path / "b", "train", {}).manifest["words"] == ["dr=friction_0.02", "seed=3"]
    finally:
        WORDS.reset(token)
    hashes = []
    for changes in ("", "+ one line", "+ another", "+ one line"):
        monkeypatch.setattr("racerl.run._git", lambda *words, told=changes: told)
        hashes.append(uncommitted())
    assert hashes[0] is None and hashes[1] == hashes[3] != hashes[2]


@pytest.mark.parametrize(
    "manifest, said",
    [
        ({"format": FORMAT + 1}, "format"),
        ({"format": FORMAT}, "no 'stage'"),
        ("[]", "object"),
        ("{", "JSON"),
    ],
)
def test_foreign_manifests_are_refused(tmp_path, manifest, said):
    text = manifest if isinstance(manifest, str) else json.dumps(manifest)
    (tmp_path / "manifest.json").write_text(text)
    with pytest.raises(RunError, match=said):
        RunFolder.open_complete(tmp_path)


def test_a_missing_config_is_named(tmp_path):
    RunFolder.start(tmp_path / "a", "train", {"seed": 1}).finish()
    (tmp_path / "a" / "config.yaml").unlink()
    with pytest.raises(RunError, match="config"):
        RunFolder.open_complete(tmp_path / "a").settings()


def test_an_unwritable_place_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(RunError, match="cannot be written"):
        RunFolder.start(tmp_path / "file" / "run", "train", {})


def test_the_hash_knows_what_matters():
    assert config_hash({"a": 1, "out": "x"}) == config_hash({"out": "y", "a": 1}) != config_hash({"a": 2})
    assert config_hash({"a": 1, "tracking": {"name": "trackio"}}) == config_hash({"a": 1})
