"""The report: complete, self-contained, reproducible, and never misled by a foreign file."""

import json
import re
import shutil

import pandas as pd
import pytest

from racerl.errors import ConfigError, RunError
from racerl.report.report import report
from racerl.report.subjects import find_subjects
from racerl.run import RunFolder


@pytest.fixture
def raced(smoke_run, smoke_evaluation, tmp_path):
    """A private copy of outputs/ in which the smoke policy has finished laps."""
    outputs = tmp_path / "outputs"
    shutil.copytree(smoke_run.parent.parent, outputs)
    path = outputs / "evaluate" / "smoke" / "metrics.json"
    metrics = json.loads(path.read_text())
    drive = pd.read_parquet(path.parent / "trajectories.parquet")
    first = drive["seed"] == 0
    drive.loc[first, "lap"] = 1
    drive.to_parquet(path.parent / "trajectories.parquet")
    metrics["rows"][0] |= {"time_s": 6.25, "valid": True, "crashed": False, "number": 1, "seed": 0}
    metrics |= {"mean_lap_s": 6.25, "fastest_valid_lap_s": 6.25, "valid_laps": 1}
    path.write_text(json.dumps(metrics))
    return outputs


def test_the_page_is_self_contained_and_complete(raced, tmp_path):
    page = report({"runs": []}, tmp_path / "report", raced).read_text()
    assert not re.search(r'(src|href)="(?!data:|#)', page) and "<script" not in page
    assert page.count("</figure>") == 4
    for name in ("racing_line", "channels", "lap_times", "learning_curve"):
        svg = (tmp_path / "report" / f"{name}.svg").read_text()
        assert svg.startswith("<?xml") and "</svg>" in svg
    for value in ("6.250", "5.561", "paper: MPC", "geometric, speed rate, friction σ = 0.02", "1 of 4"):
        assert value in page, value


def test_the_title_is_the_result(raced, tmp_path):
    page = report({"runs": []}, tmp_path / "report", raced).read_text()
    assert "<title>6.25 s, 1 of 4 laps clean</title>" in page and "<h1>6.25 s, 1 of 4 laps clean</h1>" in page


def test_runs_without_a_lap_have_a_title_too(raced, tmp_path):
    path = raced / "evaluate" / "smoke" / "metrics.json"
    nothing = {"rows": [], "laps": 0, "valid_laps": 0, "mean_lap_s": None, "fastest_valid_lap_s": None}
    path.write_text(json.dumps({**json.loads(path.read_text()), **nothing}))
    page = report({"runs": []}, tmp_path / "report", raced).read_text()
    assert "<h1>no lap finished, 0 of 0 laps clean</h1>" in page


def test_drawn_twice_it_is_byte_identical(raced, tmp_path):
    pages = [report({"runs": []}, tmp_path / name, raced).read_bytes() for name in ("a", "b")]
    assert pages[0] == pages[1]


def test_runs_can_be_named(raced, tmp_path):
    page = report({"runs": [str(raced / "train" / "smoke")]}, tmp_path / "r1", raced).read_text()
    assert "6.250" in page
    page = report({"runs": [str(raced / "evaluate" / "smoke")]}, tmp_path / "r2", raced).read_text()
    assert "6.250" in page and "Learning" in page


def test_an_unraced_run_is_said_to_be_unraced(raced, tmp_path):
    shutil.rmtree(raced / "evaluate")
    page = report({"runs": [str(raced / "train" / "smoke")]}, tmp_path / "report", raced).read_text()
    assert "has not been raced" in page and "<h1>smoke: not raced yet</h1>" in page
    with pytest.raises(RunError, match=r"holds no run that was raced; race one with: racerl evaluate .*train/smoke"):
        report({"runs": []}, tmp_path / "other", raced)


def test_what_was_not_raced_is_named_in_one_line_without_rows_or_curves(raced, tmp_path):
    unraced = raced / "train" / "newer"
    shutil.copytree(raced / "train" / "smoke", unraced)
    manifest = json.loads((unraced / "manifest.json").read_text())
    (unraced / "manifest.json").write_text(json.dumps({**manifest, "run_id": "another"}))
    RunFolder.start(raced / "gap" / "a", "gap", {}).finish()
    before = report({"runs": [str(raced / "evaluate" / "smoke")]}, tmp_path / "one", raced)
    page = report({"runs": []}, tmp_path / "all", raced)
    assert "Not raced, so not shown: train: train/newer; gap: gap/a." in page.read_text()
    assert page.read_text().count("<tr>") == before.read_text().count("<tr>")
    for name in ("learning_curve", "lap_times"):
        assert (page.parent / f"{name}.svg").read_bytes() == (before.parent / f"{name}.svg").read_bytes()


def test_incomplete_runs_are_left_out(raced, tmp_path):
    manifest = raced / "train" / "smoke" / "manifest.json"
    manifest.write_text(manifest.read_text().replace('"complete"', '"running"'))
    shutil.rmtree(raced / "evaluate")
    with pytest.raises(RunError, match="no finished run"):
        report({"runs": []}, tmp_path / "report", raced)
    with pytest.raises(RunError, match="not complete"):
        report({"runs": [str(raced / "train" / "smoke")]}, tmp_path / "report", raced)
    assert not (tmp_path / "report").exists()


@pytest.mark.parametrize("runs", [None, 3, [3]])
def test_runs_of_another_type_are_told(raced, tmp_path, runs):
    with pytest.raises(ConfigError, match="a list of run folders"):
        report({"runs": runs}, tmp_path / "report", raced)


def test_a_run_that_holds_no_laps_is_told(raced, tmp_path):
    RunFolder.start(raced / "gap" / "a", "gap", {}).finish()
    for others in ([], [str(raced / "train" / "smoke")]):
        with pytest.raises(RunError, match="gap/a: is a run of racerl gap, which holds no laps"):
            report({"runs": [*others, str(raced / "gap" / "a")]}, tmp_path / "report", raced)


def test_a_drive_without_its_steering_is_named(raced, tmp_path):
    path = raced / "evaluate" / "smoke" / "trajectories.parquet"
    pd.read_parquet(path).drop(columns="delta").to_parquet(path)
    with pytest.raises(RunError, match="delta missing"):
        report({"runs": []}, tmp_path / "report", raced)


@pytest.mark.parametrize(
    "file, content",
    [
        ("metrics.json", "{}"),
        ("metrics.json", "[1"),
        ("metrics.json", '{"label": "x", "car": "y", "track": 3}'),
        ("trajectories.parquet", "x"),
        ("track.csv", ""),
        ("track.csv", "s_m,x_m\n1,2\n"),
    ],
)
def test_damaged_evaluations_are_named(raced, tmp_path, file, content):
    (raced / "evaluate" / "smoke" / file).write_text(content)
    with pytest.raises(RunError, match="damaged"):
        report({"runs": []}, tmp_path / "report", raced)


def test_the_fastest_lap_is_closed_by_its_neighbours(raced):
    evaluation = find_subjects([], raced)[0].evaluation
    lap = evaluation.fastest_lap()
    assert set(lap["seed"]) == {0} and set(lap["lap"]) == {1}
    first_run = lap["run"].iloc[0]
    assert len(evaluation.fastest_lap(beyond=1)) <= len(lap[lap["run"] == first_run]) + 2


@pytest.mark.parametrize(
    "change", [{"mean_lap_s": "fast"}, {"rows": [3]}, {"rows": [{"seed": "a"}]}, {"mean_lap_ci95": 6.0}]
)
def test_metrics_of_another_type_are_named(raced, tmp_path, change):
    path = raced / "evaluate" / "smoke" / "metrics.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **change}))
    with pytest.raises(RunError, match="damaged"):
        report({"runs": []}, tmp_path / "report", raced)


def test_hostile_names_are_only_text(raced, tmp_path):
    path = raced / "evaluate" / "smoke" / "metrics.json"
    metrics = json.loads(path.read_text())
    path.write_text(json.dumps({**metrics, "label": "<script>alert(1)</script>"}))
    page = report({"runs": []}, tmp_path / "report", raced).read_text()
    assert "<script" not in page and "&lt;script&gt;" in page


def test_the_newest_evaluation_counts(raced):
    newer = raced / "evaluate" / "newer"
    shutil.copytree(raced / "evaluate" / "smoke", newer)
    manifest = json.loads((newer / "manifest.json").read_text())
    (newer / "manifest.json").write_text(json.dumps({**manifest, "finished": "2999-01-01T00:00:00+00:00"}))
    subjects = find_subjects([], raced)
    assert len(subjects) == 1 and subjects[0].evaluation.path == newer


def test_equal_policies_are_told_apart(raced, tmp_path):
    for stage, key in (("train", "run_id"), ("evaluate", "train_run_id")):
        copy = raced / stage / "again"
        shutil.copytree(raced / stage / "smoke", copy)
        manifest = json.loads((copy / "manifest.json").read_text())
        (copy / "manifest.json").write_text(json.dumps({**manifest, key: "another"}))
    titles = [subject.title for subject in find_subjects([], raced)]
    assert sorted(title.split(":")[0] for title in titles) == ["again", "smoke"]
    page = report({"runs": []}, tmp_path / "report", raced).read_text()
    assert "again: geometric" in page and "smoke: geometric" in page
