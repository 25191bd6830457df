"""What the READMEs promise: their length, links and choices exist, commands compose, and their Python runs."""

import re
import shutil
import sys

import numpy as np
import pytest
from PIL import Image

import racerl.config
from racerl.choices import choices
from racerl.cli import app
from racerl.completion import TWO_WORDS
from racerl.config import compose_settings
from racerl.docs.markdown import BLOCK, Transcript, anchor, blocks, commands, headings, links
from racerl.docs.sources import ROOT, readmes
from racerl.documents import conf_folder
from racerl.track.load import read_track
from racerl.vehicle import effects

README = (ROOT / "README.md").read_text(encoding="utf-8")
PAGES = list(readmes().values())
NAMES = {command.name or command.callback.__name__ for command in app.registered_commands if command.callback}
COMMANDS = NAMES - set(TWO_WORDS)


def text_of(place):
    return (ROOT / place).read_text(encoding="utf-8")


def executed(block, name):
    exec(compile(block, name, "exec"), {"__name__": name})  # noqa: S102


def test_the_readme_can_be_read_in_one_go():
    assert len(README.splitlines()) <= 200


def test_the_build_finds_its_test_command():
    assert len(re.findall(r"^python3 -m venv .*pytest$", README, re.MULTILINE)) == 1


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page):
    for target in links(page.read_text(encoding="utf-8")):
        name, _, place = target.partition("#")
        there = page.parent / name if name else page
        assert there.exists(), target
        assert not place or place in map(anchor, headings(there.read_text(encoding="utf-8"))), target


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_commands_exist(page):
    words = re.findall(r"`racerl ([a-z]+)", page.read_text(encoding="utf-8"))
    assert set(words) <= COMMANDS


def given(word, folder):
    """Put what a word names into a folder: a vehicle, a log, a run or a map set."""
    key, _, value = word.rpartition("=")
    path = folder / value
    if key in ("vehicle", "real") and path.suffix:
        path.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(conf_folder() / "vehicle" / "published.yaml", path)
    elif key == "track" and value not in choices("track"):  # one that racerl track add has named
        path = folder / "conf" / "track" / f"{value}.yaml"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("file: oval.csv\n")
    elif key in ("", "from") and (path.parent != folder or path.suffix or value.isupper()) and not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        if not path.suffix:  # a run, or a map set
            path.mkdir()
            path /= "centerline.csv"
        path.touch()


@pytest.mark.parametrize("place", [place for place, page in readmes().items() if [*commands(page.read_text())]])
def test_commands_compose(place, tmp_path, monkeypatch, run):
    """Every racerl line of a shell block is one that the command takes, with all its groups, keys and values."""

    def composed(command, words, task, positional=None):
        bare = [word for word in words if "=" not in word] if positional else []
        compose_settings(command, [word for word in words if word not in bare], {positional: bare} if bare else {})

    monkeypatch.setattr(racerl.config, "run_command", composed)
    for command in commands(text_of(place)):
        words = [word.rstrip("…") for word in Transcript(command, "").words if word[0] != "["]  # [RUN…] may be left out
        for word in words:
            given(word, tmp_path)
        done = run(*words)
        assert done.returncode == 0, f"{command}: {done.stderr}"


def test_every_command_is_in_the_readme():
    assert set(re.findall(r"^racerl ([a-z]+)", README, re.MULTILINE)) == COMMANDS
    assert all(command in README for command in TWO_WORDS)


def test_choices_exist():
    named = [
        conf_folder() / group / f"{choice}.yaml"
        for _, block in BLOCK.findall(README)
        for group, choice in re.findall(r"([a-z_/]+)=([\w./-]+)", block)
        if (conf_folder() / group).is_dir() and "/" not in choice
    ]
    assert named
    assert [path.name for path in named if not path.is_file()] == []


def test_a_centreline_comes_out_of_a_map(tmp_path, monkeypatch):
    """A ring of 2 to 3 m around (1, 2), drawn in cells of 0.05 m, with a free spot and a box that are not of it."""
    x, y = np.meshgrid(np.arange(-3.0, 5.0, 0.05) + 0.025, np.arange(-2.0, 6.0, 0.05) + 0.025)
    radius = np.hypot(x - 1.0, y - 2.0)
    image = np.where((radius > 2.0) & (radius < 3.0) | (radius < 0.5), 254, 205).astype(np.uint8)
    Image.fromarray(image[::-1]).save(tmp_path / "room.png")
    (tmp_path / "room.yaml").write_text("image: room.png\nresolution: 0.05\norigin: [-3.0, -2.0, 0.0]\nnegate: 0\n")
    (recipe,) = (block for block in blocks(text_of("racerl/track/README.md"), "python") if "sys.argv" in block)
    monkeypatch.setattr(sys, "argv", ["centreline.py", str(tmp_path / "room.yaml")])
    executed(recipe, "centreline.py")
    track = read_track(tmp_path / "room.yaml")
    assert np.allclose(np.hypot(track.x - 1.0, track.y - 2.0), 2.5, atol=0.05)
    assert np.allclose(track.width_right, 0.5, atol=0.06) and np.allclose(track.width_left, 0.5, atol=0.06)


def test_the_race_is_a_vector_environment_on_tensors(capsys):
    (recipe,) = (block for block in blocks(text_of("racerl/README.md"), "python") if "race.step" in block)
    assert len(recipe.splitlines()) <= 12
    left = {}
    exec(compile(recipe, "race.py", "exec"), left)  # noqa: S102
    assert left["observation"].shape == (400, 50) and left["observation"].isfinite().all()
    assert left["race"].faults == 0 and left["episodes"] > 0 and left["metres"].mean() > 0.0
    assert f"{left['episodes']} episodes" in capsys.readouterr().out


@pytest.mark.slow
def test_the_commands_are_functions(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (recipe,) = (block for block in blocks(text_of("racerl/README.md"), "python") if "racerl.commands" in block)
    executed(recipe, "commands.py")
    assert "named Estimate(value=0.149" in capsys.readouterr().out


def test_a_race_is_had_from_python():
    (recipe,) = blocks(README, "python")
    executed(recipe, "races.py")


def test_a_mapping_of_ones_own_is_taken(tmp_path, run):
    (mapping,) = blocks(README, "yaml")
    folder = tmp_path / "conf" / "data"
    folder.mkdir(parents=True)
    (folder / "mine.yaml").write_text(mapping)
    (tmp_path / "log.mcap").touch()
    done = run("data", "log.mcap", "data=mine", "--cfg", "job")
    assert done.returncode == 0 and "/sensors/servo_position_command" in done.stdout, done.stderr


def test_an_effect_is_one_file_and_one_yaml(tmp_path, monkeypatch, run):
    page = text_of("racerl/README.md")
    (module,) = (block for block in blocks(page, "python") if "class SideWind" in block)
    (settings,) = (block for block in blocks(page, "yaml") if "side_wind" in block)
    (tmp_path / "side_wind.py").write_text(module)
    monkeypatch.setattr(effects, "__path__", [*effects.__path__, str(tmp_path)])
    folder = tmp_path / "conf" / "vehicle" / "effect"
    folder.mkdir(parents=True)
    (folder / "side_wind.yaml").write_text(settings)
    assert "In words: wind pushes your car." in run("effects", "side_wind").stdout
    assert "force: 0.5" in run("train", "+vehicle/effect=side_wind", "--cfg", "job").stdout
    sys.modules.pop("racerl.vehicle.effects.side_wind")
