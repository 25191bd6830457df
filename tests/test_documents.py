"""Documents: atomic on the way out, bounded and inert on the way in."""

import fcntl
import json
import os
import time
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from racerl import documents
from racerl.documents import inside, read_json, read_yaml, sweep, write_bytes, write_json, write_yaml
from racerl.errors import DocumentError


def test_a_failed_write_leaves_the_old_file(tmp_path, monkeypatch):
    target = tmp_path / "a.json"
    write_json(target, {"kept": 1})

    def full(descriptor):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space"):
        write_json(target, {"kept": 2})
    assert read_json(target) == {"kept": 1} and [path.name for path in tmp_path.iterdir()] == ["a.json"]


def test_what_killed_processes_were_writing_is_swept(tmp_path):
    (tmp_path / "run").mkdir()
    left, written, young = (tmp_path / "run" / f".{name}.safetensors.abc.tmp" for name in ("a", "b", "c"))
    for path in (left, written, young, tmp_path / "other.tmp"):
        path.write_bytes(b"half")
        os.utime(path, (time.time() - 5.0,) * 2)
    os.utime(young)
    with written.open("rb") as stream:
        fcntl.flock(stream, fcntl.LOCK_EX)
        sweep(tmp_path)
    assert not left.exists() and written.exists() and young.exists() and (tmp_path / "other.tmp").exists()


def test_what_never_ends_is_not_read(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to("/dev/zero")
    for name in ("pipe", "link"):
        with pytest.raises(DocumentError, match="pipe or a device"):
            read_json(tmp_path / name)
    with pytest.raises(DocumentError, match="Is a directory"):
        read_yaml(tmp_path)
    with pytest.raises(DocumentError, match="no path"):
        read_yaml(tmp_path / "a\0b")


def test_yaml_comes_back(tmp_path):
    content = {"a": 1e-4, "b": [1, 2.5, "x"], "c": {"d": True, "e": None, "f": "friction_0.02"}}
    write_yaml(tmp_path / "a.yaml", content)
    assert read_yaml(tmp_path / "a.yaml") == content
    (tmp_path / "b.yaml").write_text("name: '1'\nrate: 1e-3\nfile: \"2024\"\n")
    assert read_yaml(tmp_path / "b.yaml") == {"name": "1", "rate": 1e-3, "file": "2024"}


@pytest.mark.parametrize(
    "text, said",
    [
        ("a: &x 1\nb: *x\n", "aliases"),
        ("a: .nan", "finite"),
        ("a: .inf", "finite"),
        ("a: [1, {b: -.inf}]", "finite"),
        ("a: !!python/object/apply:os.system [ls]", "not valid YAML"),
        ("- 1", "mapping"),
        ("a: b: c", "not valid YAML"),
        ("a: 1\nb: {c: 2, d: 3, c: 4}", "'c' is there twice in .*, line 2, column 17"),
        ("{" * 3000, "not valid YAML"),
        ("a: 1\n" + "#" * 2**20, "bytes"),
    ],
)
def test_hostile_yaml_is_refused_in_one_line(tmp_path, text, said):
    (tmp_path / "a.yaml").write_text(text)
    with pytest.raises(DocumentError, match=said) as error:
        read_yaml(tmp_path / "a.yaml")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("text", ["[1]", "{", '{"a": NaN}', '{"a": Infinity}', "[" * 100_000])
def test_bad_json_is_refused(tmp_path, text):
    (tmp_path / "a.json").write_text(text)
    with pytest.raises(DocumentError):
        read_json(tmp_path / "a.json")


def test_nan_is_never_written(tmp_path):
    with pytest.raises(ValueError):
        write_json(tmp_path / "a.json", {"a": float("nan")})
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["../x", "/etc/passwd", "a/../../x"])
def test_paths_do_not_escape(tmp_path, name):
    with pytest.raises(DocumentError, match="leads out"):
        inside(tmp_path, name)
    assert inside(tmp_path, "a/../b") == (tmp_path / "b").resolve()


def test_a_link_does_not_escape(tmp_path):
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "link").symlink_to("/etc")
    with pytest.raises(DocumentError):
        inside(tmp_path / "folder", "link/passwd")


@settings(max_examples=300)
@given(st.binary(max_size=200))
def test_random_bytes_are_read_or_refused(tmp_path_factory, content):
    path = tmp_path_factory.mktemp("fuzz") / "a"
    write_bytes(path, content)
    for read in (read_yaml, read_json):
        try:
            assert isinstance(read(path), dict)
        except DocumentError as error:
            assert "\n" not in str(error)


@given(st.dictionaries(st.text(max_size=5), st.floats(allow_nan=False, allow_infinity=False), max_size=5))
def test_json_round_trips(tmp_path_factory, content):
    path = tmp_path_factory.mktemp("json") / "a.json"
    write_json(path, content)
    assert read_json(path) == json.loads(json.dumps(content))
    assert documents.read_text(path).endswith("\n")


@pytest.mark.parametrize("number", ["1e999", "9" * 400, "-1e999"])
def test_numbers_beyond_all_computing_are_refused(tmp_path, number):
    for read, text in ((read_json, f'{{"a": [{number}]}}'), (read_yaml, f"a: [{number}]")):
        (tmp_path / "a").write_text(text)
        with pytest.raises(DocumentError, match="a"):
            read(tmp_path / "a")


def test_a_sealed_file_is_read_as_it_was_written_or_not_at_all(tmp_path):
    path = tmp_path / "a"
    documents.write_sealed(path, b"content", "about")
    assert documents.read_sealed(path, 100, "about") == b"content"
    with pytest.raises(DocumentError, match="not what was written"):
        documents.read_sealed(path, 100, "something else")
    content = path.read_bytes()
    for at in range(len(content)):
        path.write_bytes(content[:at] + bytes([content[at] ^ 1]) + content[at + 1 :])
        with pytest.raises(DocumentError, match="not what was written"):
            documents.read_sealed(path, 100, "about")


@pytest.mark.parametrize("name", ["pipe", "device", "folder", "empty", "nothing"])
def test_only_files_with_content_are_handed_to_libraries(tmp_path, name):
    path = tmp_path / name
    make = {"pipe": os.mkfifo, "device": lambda p: p.symlink_to("/dev/zero"), "folder": Path.mkdir, "empty": Path.touch}
    make.get(name, lambda p: None)(path)
    with pytest.raises(DocumentError):
        documents.require_content(path)
    (tmp_path / "sound").write_text("x")
    documents.require_content(tmp_path / "sound")


def test_a_file_that_never_ends_is_read_to_its_size(tmp_path):
    (tmp_path / "endless").symlink_to("/proc/self/environ")  # the kernel says that it has no bytes
    assert documents.read_bytes(tmp_path / "endless", 100) == b""
