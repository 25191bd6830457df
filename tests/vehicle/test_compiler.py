"""Compiled kernels run as code: only what racerl itself has built is loaded."""

import logging
import os
import time

import pytest

from racerl.vehicle import compiler
from racerl.vehicle.compiler import build, cache_folder, telling
from tests.vehicle.test_kernel import needs_compiler

SEVEN = "int seven(void) { return 7; }"


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "racerl" / "kernels"


@needs_compiler
@pytest.mark.parametrize("harm", ["truncated", "foreign", "empty"])
def test_a_damaged_library_is_built_anew(harm, cache, caplog):
    assert build(SEVEN).seven() == 7
    (library,) = cache.glob("*.so")
    content = library.read_bytes()
    assert build("int eight(void) { return 8; }").eight() == 8
    (other,) = set(cache.glob("*.so")) - {library}
    # a new file: the old one is loaded, and changing it would end this process
    library.unlink()
    library.write_bytes({"truncated": content[:2000], "foreign": other.read_bytes(), "empty": b""}[harm])
    with caplog.at_level(logging.WARNING):
        assert build(SEVEN).seven() == 7
    assert "is damaged; it is built anew" in caplog.text and library.read_bytes() == content


@needs_compiler
def test_who_listens_hears_of_what_is_compiled_and_of_nothing_that_is_kept(cache):
    heard = []
    with telling(lambda: heard.append(1)):
        for _ in range(2):
            build(SEVEN)
    build("int nine(void) { return 9; }")
    assert heard == [1]


def test_the_folder_is_private_whatever_the_umask(cache):
    old = os.umask(0)
    try:
        assert cache_folder() == cache
    finally:
        os.umask(old)
    for folder in (cache, cache.parent, cache.parent.parent):
        assert folder.stat().st_mode & 0o777 == 0o700


def test_what_others_could_have_put_there_is_not_loaded(cache, caplog):
    cache.mkdir(parents=True)
    cache.chmod(0o777)
    (cache / "planted.so").write_bytes(b"code")
    with caplog.at_level(logging.WARNING):
        assert cache_folder() == cache
    assert not list(cache.iterdir()) and cache.stat().st_mode & 0o777 == 0o700
    assert "could be written by others" in caplog.text


@needs_compiler
def test_a_folder_that_cannot_be_used_is_replaced_for_this_process(cache, caplog):
    cache.parent.mkdir(parents=True)
    cache.write_text("a file")
    with caplog.at_level(logging.WARNING):
        assert build(SEVEN).seven() == 7
        folder = cache_folder()
    assert folder != cache and folder.stat().st_mode & 0o777 == 0o700 and folder == cache_folder()
    assert caplog.text.count("kernels are not kept") == 1
    cache.unlink()
    cache.parent.parent.chmod(0o777)  # anybody could put another folder in its place
    assert cache_folder() != cache


def test_another_users_folder_is_not_used(cache, monkeypatch):
    cache_folder()
    monkeypatch.setattr(os, "geteuid", lambda: 12345)
    assert cache_folder() != cache


@needs_compiler
def test_what_a_killed_compiler_left_is_swept(cache):
    cache_folder()
    for name, age in (("build-old", 2 * compiler.ABANDONED), ("build-new", 0.0)):
        (cache / name).mkdir()
        (cache / name / "kernel.c").write_text("")
        os.utime(cache / name, (time.time() - age,) * 2)
    build(SEVEN)
    assert {path.name for path in cache.glob("build-*")} == {"build-new"}
