"""What the READMEs promise: their length, links, commands and choices exist, and the recipe for a centreline works."""

import re
import sys

import numpy as np
import pytest
from PIL import Image

from racerl.cli import app
from racerl.completion import TWO_WORDS
from racerl.documents import conf_folder
from racerl.track.load import read_track

ROOT = conf_folder().parent
README = (ROOT / "README.md").read_text(encoding="utf-8")
FOLDERS = ("outputs/reference", "racerl", "conf", "sweeps", "tests")
PAGES = [ROOT / "README.md", *sorted(page for folder in FOLDERS for page in (ROOT / folder).rglob("*.md"))]
BLOCKS = re.compile(r"^```(\w+)\n(.*?)^```", re.MULTILINE | re.DOTALL)
NAMES = {command.name or command.callback.__name__ for command in app.registered_commands if command.callback}
COMMANDS = NAMES - set(TWO_WORDS)


def anchors(page):
    headings = re.findall(r"^#+ (.+)$", BLOCKS.sub("", page.read_text(encoding="utf-8")), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_the_readme_can_be_read_in_one_go():
    assert len(README.splitlines()) <= 200


def test_the_build_finds_its_test_command():
    assert len(re.findall(r"^python3 -m venv .*pytest$", README, re.MULTILINE)) == 1


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page):
    text = BLOCKS.sub("", page.read_text(encoding="utf-8"))
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if target.startswith("http"):
            continue
        name, _, anchor = target.partition("#")
        there = page.parent / name if name else page
        assert there.exists(), target
        assert not anchor or anchor in anchors(there), target


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_commands_exist(page):
    text = page.read_text(encoding="utf-8")
    shell = "\n".join(block for kind, block in BLOCKS.findall(text) if kind in ("sh", "console"))
    words = re.findall(r"\bracerl ([a-z]+)", re.sub(r"#.*", "", shell)) + re.findall(r"`racerl ([a-z]+)", text)
    assert set(words) <= COMMANDS


def test_every_command_is_in_the_readme():
    assert set(re.findall(r"^racerl ([a-z]+)", README, re.MULTILINE)) == COMMANDS
    assert all(command in README for command in TWO_WORDS)


def test_choices_exist():
    choices = [
        conf_folder() / group / f"{choice}.yaml"
        for _, block in BLOCKS.findall(README)
        for group, choice in re.findall(r"([a-z_/]+)=([\w./-]+)", block)
        if (conf_folder() / group).is_dir() and "/" not in choice
    ]
    assert choices
    assert [path.name for path in choices if not path.is_file()] == []


def test_a_centreline_comes_out_of_a_map(tmp_path, monkeypatch):
    """A ring of 2 to 3 m around (1, 2), drawn in cells of 0.05 m, with a free spot and a box that are not of it."""
    x, y = np.meshgrid(np.arange(-3.0, 5.0, 0.05) + 0.025, np.arange(-2.0, 6.0, 0.05) + 0.025)
    radius = np.hypot(x - 1.0, y - 2.0)
    image = np.where((radius > 2.0) & (radius < 3.0) | (radius < 0.5), 254, 205).astype(np.uint8)
    Image.fromarray(image[::-1]).save(tmp_path / "room.png")
    (tmp_path / "room.yaml").write_text("image: room.png\nresolution: 0.05\norigin: [-3.0, -2.0, 0.0]\nnegate: 0\n")
    page = (ROOT / "racerl" / "track" / "README.md").read_text(encoding="utf-8")
    (recipe,) = (block for kind, block in BLOCKS.findall(page) if kind == "python" and "sys.argv" in block)
    monkeypatch.setattr(sys, "argv", ["centreline.py", str(tmp_path / "room.yaml")])
    exec(compile(recipe, "centreline.py", "exec"), {})  # noqa: S102
    track = read_track(tmp_path / "room.yaml")
    assert np.allclose(np.hypot(track.x - 1.0, track.y - 2.0), 2.5, atol=0.05)
    assert np.allclose(track.width_right, 0.5, atol=0.06) and np.allclose(track.width_left, 0.5, atol=0.06)


def test_the_race_is_a_vector_environment_on_tensors(capsys):
    page = (ROOT / "racerl" / "README.md").read_text(encoding="utf-8")
    (recipe,) = (block for kind, block in BLOCKS.findall(page) if kind == "python" and "race.step" in block)
    assert len(recipe.splitlines()) <= 12
    left = {}
    exec(compile(recipe, "race.py", "exec"), left)  # noqa: S102
    assert left["observation"].shape == (400, 50) and left["observation"].isfinite().all()
    assert left["race"].faults == 0 and left["episodes"] > 0 and left["metres"].mean() > 0.0
    assert f"{left['episodes']} episodes" in capsys.readouterr().out


@pytest.mark.slow
def test_the_commands_are_functions(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    page = (ROOT / "racerl" / "README.md").read_text(encoding="utf-8")
    (recipe,) = (block for kind, block in BLOCKS.findall(page) if kind == "python" and "racerl.commands" in block)
    exec(compile(recipe, "commands.py", "exec"), {})  # noqa: S102
    assert "named Estimate(value=0.149" in capsys.readouterr().out
