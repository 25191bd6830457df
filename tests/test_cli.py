"""The command line as a user meets it: real processes in an empty folder."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

import racerl

PROGRAM = [sys.executable, "-m", "racerl.cli"]
ROOT = Path(racerl.__file__).parent.parent


def run(*words, cwd, timeout=120):
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.run([*PROGRAM, *words], cwd=cwd, capture_output=True, text=True, timeout=timeout, env=environment)


def test_train_evaluate_report(tmp_path):
    done = run("train", "+dr=friction_0.02", "budget=smoke", "out=outputs/train/first", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "policy in outputs/train/first" in done.stdout and done.stderr == ""
    done = run("evaluate", "outputs/train/first", "laps=1", "seeds=[0]", cwd=tmp_path)
    assert done.returncode == 0 and "metrics.json" in done.stdout, done.stderr
    done = run("report", cwd=tmp_path)
    assert done.returncode == 0 and "report.html" in done.stdout, done.stderr
    page = Path(tmp_path, done.stdout.split("report in ")[1].strip()).read_text()
    assert "friction σ = 0.02" in page
    assert sorted(path.name for path in (tmp_path / "outputs").iterdir()) == ["evaluate", "report", "train"]


def test_report_compare(tmp_path):
    done = run("report", "compare", "paper:rl", "paper:human", "out=duel", cwd=tmp_path)
    assert done.returncode == 0 and "report in duel/report.html" in done.stdout, done.stderr
    assert {"compare.svg", "report.html", "manifest.json"} <= {path.name for path in (tmp_path / "duel").iterdir()}
    done = run("report", "compare", "paper:rl", cwd=tmp_path)
    assert done.returncode == 2 and "two are compared" in done.stderr and done.stderr.count("\n") == 1


def test_record(tmp_path):
    done = run("record", "drive=race", "seconds=2", "out=drive", cwd=tmp_path)
    assert done.returncode == 0 and "200 rows in 1 runs in drive/log.parquet" in done.stdout, done.stderr
    assert {path.name for path in (tmp_path / "drive").iterdir()} >= {"log.parquet", "vehicle.yaml", "manifest.json"}


def test_drive(tmp_path, monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    done = run("drive", "input=script", "laps=1", "out=first", cwd=tmp_path)
    assert done.returncode == 0 and done.stderr == "", done.stderr
    assert "the drive is in first/log.parquet; draw it with: racerl report first" in done.stdout
    assert {"log.parquet", "metrics.json", "trajectories.parquet"} <= {p.name for p in (tmp_path / "first").iterdir()}


def test_data(tmp_path):
    t = [0.01 * i for i in range(500)]
    rows = [f"{x:.2f},{1 + 0.2 * x:.4f},{50 * (1 + 0.2 * x):.4f}" for x in t]
    (tmp_path / "drive.csv").write_text("t,v_x,omega\n" + "\n".join(rows))
    done = run("data", "drive.csv", "out=seen", cwd=tmp_path)
    assert done.returncode == 0 and done.stderr == "", done.stderr
    assert "warning: omega is 50 times v_x" in done.stdout and "report in seen/report.html" in done.stdout
    assert {"data.json", "log_0.parquet", "report.html"} <= {path.name for path in (tmp_path / "seen").iterdir()}
    done = run("data", "drive.csv", "out=seen", cwd=tmp_path)
    assert done.returncode == 2 and "already holds" in done.stderr


def test_warnings_reach_the_user(tmp_path):
    """Without a compiler on the PATH the simulator falls back to torch, and one line says so."""
    environment = {"PYTHONPATH": str(ROOT), "PATH": "/nowhere", "HOME": str(tmp_path)}
    words = ["train", "budget=smoke", "budget.steps=1024", "out=run"]
    done = subprocess.run(
        [*PROGRAM, *words], cwd=tmp_path, capture_output=True, text=True, timeout=120, env=environment
    )
    assert done.returncode == 0 and done.stderr.count("no C compiler found") == 1, done


def test_multirun_gives_each_job_its_folder(tmp_path):
    done = run("train", "-m", "dr=none,friction_0.1", "budget=smoke", "budget.steps=1024", "out=sweep", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    sigmas = [json.loads((tmp_path / "sweep" / name / "manifest.json").read_text())["config_hash"] for name in "01"]
    assert len(set(sigmas)) == 2


def test_cfg_job_prints_the_composed_config(tmp_path):
    done = run("train", "--cfg", "job", "+dr=all_0.05", cwd=tmp_path)
    assert done.returncode == 0 and "sigma: 0.05" in done.stdout and not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "words, said",
    [
        (["trian"], "Did you mean 'train'"),
        (["train", "dr=frction_0.02"], "friction_0.02"),
        (["train", "bugdet=smoke"], "budget"),
        (["train", "+colour=red"], "unknown key"),
        (["train", "--mulitrun"], "--multirun"),
        (["train", "dr.sigma=wide", "budget=smoke"], "dr.sigma"),
        (["train", "vehicle.mass=-1"], "0.1"),
        (["train", "track=nowhere.csv"], "no such file"),
        (["evaluate"], "run=…"),
        (["evaluate", "nowhere"], "no racerl run folder"),
        (["report"], "no finished run"),
        (["data"], "logs=…"),
        (["data", "nowhere.csv"], "no such file"),
        (["data", "nowhere.csv", "data=drat"], "did you mean dart"),
        (["data", "nowhere.csv", "data.savgol.window=4"], "odd number"),
    ],
)
def test_mistakes_end_with_one_line_and_leave_nothing(words, said, tmp_path):
    done = run(*words, cwd=tmp_path)
    lines = [line for line in done.stderr.splitlines() if line]
    assert done.returncode == 2 and len(lines) == 1 and lines[0].startswith("racerl: ") and said in lines[0], done
    assert "Traceback" not in done.stdout + done.stderr
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]


def test_help_is_quick_and_complete(tmp_path):
    times = []
    for _ in range(5):
        began = time.perf_counter()
        done = run("--help", cwd=tmp_path)
        times.append(time.perf_counter() - began)
    assert all(name in done.stdout for name in ("train", "evaluate", "report", "data"))
    assert min(times) < 0.7


def test_no_command_shows_the_help(tmp_path):
    done = run(cwd=tmp_path)
    assert done.returncode == 0 and "Usage" in done.stdout


@pytest.mark.parametrize("word, expected", [("dr=fri", "dr=friction_0.02"), ("+dr=al", "+dr=all_0.1"), ("ob", "obs=")])
def test_completion_knows_the_groups(word, expected):
    from racerl.cli import _complete

    assert expected in _complete(word)
    assert _complete("nonsense=") == []
