"""The notebooks run from their first cell to the last, and come to what they promise."""

import ast
import re
import runpy
import sys
from pathlib import Path

import pandas as pd
import pytest

from racerl import notebooks
from racerl.commands import Diagnosis, Identification, Picture, Training

FOLDER = Path(notebooks.__file__).parent
NOTEBOOKS = sorted(path.stem for path in FOLDER.glob("*.py") if path.stem != "__init__")
CELL = re.compile(r"^# %%(.*)\n", re.MULTILINE)


@pytest.fixture
def run(tmp_path, monkeypatch):
    """Run a notebook as a script in an empty folder; return what its cells have left."""

    def called(name, *words):
        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr(sys, "argv", [f"{name}.py", *words])
        return runpy.run_path(str(FOLDER / f"{name}.py"))

    return called


def cells(name):
    """Return a notebook's cells: what stands behind their marks, and their text."""
    before, *rest = CELL.split((FOLDER / f"{name}.py").read_text(encoding="utf-8"))
    assert before == ""
    return list(zip(rest[::2], rest[1::2], strict=True))


def figures(name):
    """Return the code of a notebook's cells that end in a figure."""
    code = [text for kind, text in cells(name) if not kind]
    return [ast.unparse(last) for text in code if "figures" in ast.unparse(last := ast.parse(text).body[-1])]


@pytest.mark.parametrize("name", NOTEBOOKS)
def test_cells_are_text_or_code(name):
    kinds = [kind for kind, _ in cells(name)]
    assert set(kinds) == {"", " [markdown]"} and kinds[0] == " [markdown]" and len(figures(name)) >= 2
    for kind, text in cells(name):
        statements = ast.parse(text).body
        assert (ast.get_docstring(ast.parse(text)) is not None and len(statements) == 1) == bool(kind)
    assert f"`{name}`" in notebooks.__doc__


def require_figures(name, left):
    for shown in figures(name):
        picture = eval(shown, left)  # noqa: S307
        assert isinstance(picture, Picture) and picture._repr_svg_().lstrip().startswith("<?xml"), shown


def test_a_first_policy_is_trained_and_raced(run, capsys):
    left = run("first_policy", "quick")
    assert Training.of(left["policy"].folder).facts["steps"] == 2048
    assert len(left["model"].laps) == len(left["twin"].laps) == 6 and left["twin"].facts["car"] == "twin"
    assert left["page"].figures["learning_curve"]._repr_svg_() and left["page"].page.is_file()
    assert 0.0 < left["metres"] < 100.0
    printed = capsys.readouterr().out
    assert "share of crashes" in printed and str(left["page"].page) in printed


def test_a_logs_numbers_are_found(run):
    left = run("my_own_log", "quick")
    inertia = left["found"].parameters["yaw_inertia"]
    assert inertia.low < left["HIDDEN"] < inertia.high and inertia.high - inertia.low < 0.01 * left["HIDDEN"]
    assert left["seen"].warnings == [] and left["log"].is_file()
    assert list(left["numbers"].columns) == ["value", "low", "high", "unit"]
    assert Identification.of(left["found"].folder).model.is_file()
    require_figures("my_own_log", left)


@pytest.mark.slow
def test_what_is_hidden_is_named(run, capsys):
    left = run("what_is_missing", "quick")
    require_named(left)
    assert "named: yaw_damping" in capsys.readouterr().out


def require_named(left):
    found, effects = Diagnosis.of(left["found"].folder), left["effects"]
    assert found.verdict == "named" and list(found.effects) == ["yaw_damping"] == list(effects["effect"])
    (row,) = effects.to_dict("records")
    assert row["low"] < 0.15 < row["high"] and row["unit"] == "N m s"
    require_figures("what_is_missing", left)


@pytest.mark.slow
def test_what_is_hidden_is_named_among_all(run):
    left = run("what_is_missing")
    facts = left["found"].facts
    assert len({*facts["separable"], *facts["blind_to"]}) > 30  # tried, or told that the log cannot show them
    require_named(left)


@pytest.mark.slow
def test_a_log_of_five_minutes_makes_a_model(run):
    left = run("my_own_log")
    inertia = left["found"].parameters["yaw_inertia"]
    assert left["found"].usable and inertia.low < left["HIDDEN"] < inertia.high
    require_figures("my_own_log", left)


@pytest.mark.slow
def test_a_first_policy_laps_cleanly(run):
    """Some four minutes on two cores."""
    left = run("first_policy")
    raced: pd.DataFrame = left["raced"]
    assert raced.loc["clean laps", "model"] >= 57 and (raced.loc["share of crashes"] == 0.0).all()
    # it keeps 4 cm, so in the twin it may cross the edge, by a hair
    assert left["twin"].laps["max_off_track_m"].max() < 0.05 and left["twin"].facts["e_off"] < 0.002
    assert 5.2 < raced.loc["mean lap in s", "model"] < 5.7
    require_figures("first_policy", left)
