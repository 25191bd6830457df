"""Each entry of mutations.yaml breaks one thing in a copy of the project, and the test that it names must notice."""

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

ROOT = Path(__file__).parent.parent
MUTATIONS: list[dict[str, str]] = yaml.safe_load((ROOT / "tests" / "mutations.yaml").read_text())["mutations"]
COPIED = ("racerl", "conf", "sweeps", "tests", "outputs", "README.md", "pyproject.toml")
mutations = pytest.mark.parametrize("mutation", MUTATIONS, ids=lambda mutation: mutation["what"].replace(" ", "-"))


@mutations
def test_the_text_that_is_broken_stands_once_and_the_guard_is_there(mutation: dict[str, str]):
    assert (ROOT / mutation["file"]).read_text().count(mutation["old"]) == 1
    file, _, name = mutation["test"].partition("::")
    assert f"def {name.partition('[')[0]}(" in (ROOT / file).read_text()


def test_the_readme_lists_them():
    table = (ROOT / "tests" / "README.md").read_text()
    for mutation in MUTATIONS:
        file, _, name = mutation["test"].partition("::")
        assert f"| {mutation['what']} | `{mutation['file']}` | `{file}::{name}` |" in table


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("copy")
    for name in COPIED:
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(ROOT / name, folder)
    return folder


def run(test: str, copy: Path) -> Any:
    command = [sys.executable, "-m", "pytest", "-x", "-n0", "-p", "no:cacheprovider", "-m", "", test]
    environment = {**os.environ, "PYTHONPATH": str(copy), "PYTHONDONTWRITEBYTECODE": "1"}
    return subprocess.run(command, cwd=copy, env=environment, capture_output=True, text=True, timeout=600)


@pytest.mark.slow
@mutations
def test_what_is_broken_is_noticed(mutation: dict[str, str], copy: Path):
    path = copy / mutation["file"]
    sound = path.read_text()
    try:
        path.write_text(sound.replace(mutation["old"], mutation["new"]))
        done = run(mutation["test"], copy)
    finally:
        path.write_text(sound)
    assert done.returncode == 1 and "1 failed" in done.stdout, done.stdout[-2000:]


@pytest.mark.slow
def test_the_copy_is_sound(copy: Path):
    done = run("tests/track/test_frenet.py", copy)
    assert done.returncode == 0, done.stdout[-2000:]
