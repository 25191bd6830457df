"""The command line as a user meets it: in this process, or in one of its own where the process is what counts."""

import functools
import json
import os
import pty
import select
import shlex
import subprocess
import sys
import time
from pathlib import Path

import pandas as pd
import pytest

import racerl
from racerl.cli import _console, _following, _print_verdict, app
from racerl.completion import TWO_WORDS
from racerl.config import compose_settings, gather_words
from racerl.vehicle import compiler
from tests.conftest import CONF

PROGRAM = [sys.executable, "-m", "racerl.cli"]
ROOT = Path(racerl.__file__).parent.parent


def process(*words, cwd, **environment):
    variables = {**os.environ, "PYTHONPATH": str(ROOT), **environment}
    return subprocess.run([*PROGRAM, *words], cwd=cwd, capture_output=True, text=True, timeout=120, env=variables)


@pytest.mark.parametrize("found", ["", "effects", "helped"])
def test_effects_are_told_of_where_some_were_found(capsys, found):
    gap = {"unfitted": 2.0, "before": 1.01, "after": 1.005, "explained": 0.0}
    nothing = dict.fromkeys(("ambiguous_with", "hypotheses", "blind_to", "logs", "remarks", "effects", "helped"), ())
    said = {"verdict": "unknown", "reason": "…", "residual": None, "next_manoeuvre": ""}
    effects = {found: [{"name": "yaw_damping", "parameters": {}}]} if found else {}
    facts = {**nothing, **said, "configured": {"changes": [], "rest": 0.0}, "gap": gap, **effects}
    _print_verdict(_console(), facts)
    line = "gap over the noise: 2.00 as configured, 1.01 refitted" + bool(found) * ", 1.00 with the effects found"
    assert line in capsys.readouterr().out.splitlines()


def test_train_evaluate_report(tmp_path, run):
    done = run("train", "+dr=friction_0.02", "budget=smoke", "out=outputs/train/first")
    assert done.returncode == 0, done.stderr
    assert "policy in outputs/train/first" in done.stdout and done.stderr == ""
    done = run("evaluate", "outputs/train/first", "laps=1", "seeds=[0]")
    assert done.returncode == 0 and "metrics.json" in done.stdout, done.stderr
    done = run("report")
    assert done.returncode == 0 and "report.html" in done.stdout, done.stderr
    page = Path(tmp_path, done.stdout.split("report in ")[1].strip()).read_text()
    assert "friction σ = 0.02" in page
    assert sorted(path.name for path in (tmp_path / "outputs").iterdir()) == ["evaluate", "report", "train"]


def test_report_compare(tmp_path, run):
    done = run("report", "compare", "paper:rl", "paper:human", "out=duel")
    assert done.returncode == 0 and "report in duel/report.html" in done.stdout, done.stderr
    assert {"compare.svg", "report.html", "manifest.json"} <= {path.name for path in (tmp_path / "duel").iterdir()}
    done = run("report", "compare", "paper:rl")
    assert done.returncode == 2 and "two are compared" in done.stderr and done.stderr.count("\n") == 1


def test_record(tmp_path, run):
    done = run("record", "drive=race", "seconds=2", "out=drive")
    assert done.returncode == 0 and "200 rows in 1 run in drive/log.parquet" in done.stdout, done.stderr
    assert {path.name for path in (tmp_path / "drive").iterdir()} >= {"log.parquet", "vehicle.yaml", "manifest.json"}


def test_drive(tmp_path, monkeypatch, run):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    done = run("drive", "input=script", "laps=1", "out=first")
    assert done.returncode == 0 and done.stderr == "", done.stderr
    assert done.stdout.endswith("next: racerl report first\n")
    assert {"log.parquet", "metrics.json", "trajectories.parquet"} <= {p.name for p in (tmp_path / "first").iterdir()}


def test_track(tmp_path, run):
    """A track that is shown, then one that is added and raced by its name."""
    done = run("track", "l_shape", "out=shown")
    assert done.returncode == 0 and "17.5 m, clockwise, 1 m wide" in done.stdout, done.stderr
    assert {"track.json", "track.svg", "manifest.json"} <= {path.name for path in (tmp_path / "shown").iterdir()}
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "mine_centerline.csv").write_bytes((CONF / "track" / "oval.csv").read_bytes())
    done = run("track", "add", "mine", "out=added")
    assert done.returncode == 0 and done.stderr == "", done.stderr
    assert done.stdout.splitlines()[-1] == "next: racerl train track=mine"
    done = run("train", "track=mine", "budget=smoke", "budget.steps=1024", "out=trained")
    assert done.returncode == 0, done.stderr


def test_data(tmp_path, run):
    t = [0.01 * i for i in range(500)]
    rows = [f"{x:.2f},{1 + 0.2 * x:.4f},{50 * (1 + 0.2 * x):.4f}" for x in t]
    (tmp_path / "drive.csv").write_text("t,v_x,omega\n" + "\n".join(rows))
    done = run("data", "drive.csv", "out=seen")
    assert done.returncode == 0 and done.stderr == "", done.stderr
    assert "warning: omega is 50 times v_x" in done.stdout and "report in seen/report.html" in done.stdout
    assert {"data.json", "log_0.parquet", "report.html"} <= {path.name for path in (tmp_path / "seen").iterdir()}
    done = run("data", "drive.csv", "out=seen")
    assert done.returncode == 2 and "already holds" in done.stderr


def test_warnings_reach_the_user(tmp_path, monkeypatch, run):
    """Without a compiler on the PATH the simulator falls back to torch, and one line says so."""
    for name, value in {"PATH": "/nowhere", "CC": "", "XDG_CACHE_HOME": str(tmp_path)}.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(compiler, "find_compiler", functools.cache(compiler.find_compiler.__wrapped__))
    words = [
        "train",
        "budget=smoke",
        "budget.cars=4",
        "budget.rollout=8",
        "budget.batch=32",
        "budget.steps=32",
        "out=run",
    ]
    done = run(*words)
    assert done.returncode == 0 and done.stderr.count("no C compiler found") == 1, done


@pytest.mark.slow
def test_multirun_gives_each_job_its_folder(tmp_path, run):
    done = run("train", "-m", "dr=none,friction_0.1", "budget=smoke", "budget.steps=1024", "out=sweep")
    assert done.returncode == 0, done.stderr
    sigmas = [json.loads((tmp_path / "sweep" / name / "manifest.json").read_text())["config_hash"] for name in "01"]
    assert len(set(sigmas)) == 2


def test_cfg_job_prints_the_composed_config(tmp_path, run):
    done = run("train", "--cfg", "job", "+dr=all_0.05")
    assert done.returncode == 0 and "sigma: 0.05" in done.stdout and not list(tmp_path.iterdir())
    (tmp_path / "mine.yaml").write_text("name: mpc\n")
    done = run("tune", "mine.yaml", "--cfg", "job")
    assert done.returncode == 0 and "file: mine.yaml" in done.stdout
    done = run("tune", "mpc", "--cfg", "job")
    assert done.returncode == 0 and "name: mpc" in done.stdout
    done = run("gap", ".", "vehicle=published", "--cfg", "job")  # a log, a choice, then an option
    assert done.returncode == 0 and "mass: 5.1" in done.stdout, done.stderr


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
        (["evaluate"], "racerl evaluate RUN"),
        (["evaluate", "nowhere"], "no such file or folder"),
        (["report"], "no "),
        (["data"], "racerl data LOG…"),
        (["bench"], "which benchmark? There are"),
        (["data", "nowhere.csv"], "no such file"),
        (["data", ".", "data=drat"], "did you mean dart"),
        (["data", ".", "data.savgol.window=4"], "odd number"),
    ],
)
def test_mistakes_end_with_one_line_and_leave_nothing(words, said, tmp_path, run):
    done = run(*words)
    lines = [line for line in done.stderr.splitlines() if line]
    assert done.returncode == 2 and len(lines) == 1 and lines[0].startswith("racerl: ") and said in lines[0], done
    assert "Traceback" not in done.stdout + done.stderr
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]


@pytest.mark.parametrize(
    "out, said",
    [
        ("/dev/null", "File exists"),
        ("/dev/null/x", "Not a directory"),
        ("a" * 300, "File name too long; choose a shorter"),
    ],
)
def test_what_the_system_refuses_ends_with_one_line(out, said, tmp_path, run):
    for words in (["record", "drive=race", "seconds=2"], ["train", "budget=smoke"], ["report"]):
        done = run(*words, f"out={out}")
        assert done.returncode == 2 and said in done.stderr and done.stderr.count("\n") == 1, done.stderr
        assert "Traceback" not in done.stdout + done.stderr and not list(tmp_path.iterdir())


ODD = ("Größe/测试", "a,b", "[x]", "a b", "x{1}", "it's", 'q"q', "d$x")


@pytest.mark.parametrize("out", ["".join(ODD), *(pytest.param(name, marks=pytest.mark.slow) for name in ODD)])
def test_a_folder_may_have_any_name(out, tmp_path, run):
    done = run("record", "drive=race", "seconds=2", f"out={out}")
    assert done.returncode == 0 and (tmp_path / out / "log.parquet").is_file(), done.stderr
    done = run("data", f"{out}/log.parquet", "out=seen")
    assert done.returncode == 0, done.stderr


def test_a_full_disk_ends_with_one_line(tmp_path, run, monkeypatch):
    def full(descriptor):
        raise OSError(28, "No space left on device", "drive/log.parquet")

    monkeypatch.setattr(os, "fsync", full)
    done = run("record", "drive=race", "seconds=2", "out=drive")
    assert done.returncode == 2 and done.stderr.count("\n") == 1
    assert "No space left on device" in done.stderr


@pytest.mark.parametrize(
    "words, said",
    [
        (["gap"], "logs is missing; write racerl gap LOG…"),
        (["gap", "close", "."], "real is missing; write racerl gap close LOG… real=FILE"),
        (["report", "compare", "nobody"], "nobody: no such file or folder in"),
        (["train", "budget.gama=1"], "did you mean budget.gamma"),
        (["train", "p_Dx1=1"], "did you mean vehicle.front.p_Dx1 or vehicle.rear.p_Dx1"),
        (["train", "colour=red"], "its groups are action, algo, budget,"),
        (["train", "colour=red"], "All keys: racerl train --cfg job"),
        (["evaluate", "controller=mpc", "dr=friction_0.02"], "All keys: racerl evaluate --cfg job"),
        (["sweep", "ablatoins"], "did you mean ablations"),
        (["train", "seed=one"], "seed = one: a number is expected"),
        (["train", "track=mine.csv"], "mine.csv: no such file in "),
        (["track", "add"], "racerl track add FOLDER"),
        (["track", "add", "nowhere"], "nowhere: no such file or folder in "),
        (["track", "add", "."], "holds no track; give a centreline .csv"),
        (["track", "add", "oval", "bean"], "one track is expected"),
        (["track", "ovl"], "did you mean oval"),
    ],
)
def test_mistakes_say_what_to_write(words, said, run, tmp_path):
    done = run(*words)
    assert done.returncode == 2 and said in done.stderr and done.stderr.count("\n") == 1
    assert len(done.stderr) < 300 + len(str(tmp_path)), "a line that nobody reads"
    if "no such file" in said:
        assert str(tmp_path) in done.stderr


DRAWING = "import typer.main, rich.markdown, rich.panel, rich.table"  # what no help can be drawn without
LIGHT = """import sys; from racerl.cli import main
try: main()
finally: print([name for name in ("torch", "scipy") if name in sys.modules])"""


@pytest.mark.parametrize(
    "words",
    [
        ["gap", "--help"],
        ["train", "--cfg", "job"],
        ["train", "bugdet=smoke"],
        ["train", "dr.sigma=wide"],
        ["sweep", "ablatoins"],
        ["identify", "nowhere.csv"],
        ["train", "track=nowhere.csv"],
        ["track", "add", "nowhere"],
    ],
    ids=" ".join,
)
def test_words_are_read_before_anything_heavy(words, tmp_path):
    command = [sys.executable, "-c", LIGHT, *words]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=60, env=environment)
    assert done.stdout.splitlines()[-1] == "[]" and "Traceback" not in done.stderr, done


def test_help_is_quick_and_complete(tmp_path):
    helped, drawn = [], []  # s of the processor, by turns, as a busy machine slows both
    for _ in range(5):
        drawn.append(_processor(lambda: subprocess.run([sys.executable, "-c", DRAWING], cwd=tmp_path, check=True)))
        helped.append(_processor(lambda: process("--help", cwd=tmp_path)))
    done = process("--help", cwd=tmp_path)
    assert all(name in done.stdout for name in ("train", "evaluate", "report", "data"))
    assert min(helped) < 2 * min(drawn), (helped, drawn)


def _processor(work):
    before = os.times()
    work()
    after = os.times()
    return after.children_user + after.children_system - before.children_user - before.children_system


def test_a_process_of_its_own_ends_with_one_line(tmp_path):
    done = process("trian", cwd=tmp_path)
    assert done.returncode == 2 and done.stderr.startswith("racerl: ") and done.stderr.count("\n") == 1


@pytest.mark.parametrize(
    "command", ["", *(command.name or command.callback.__name__ for command in app.registered_commands)]
)
def test_help_shows_every_word_of_it(command, run):
    """Nothing in brackets is taken for markup."""
    texts = {c.name or c.callback.__name__: c.callback.__doc__ for c in app.registered_commands}
    done = run(*command.split(), "--help")
    told = " ".join(done.stdout.split())
    assert done.returncode == 0
    if command:
        assert " ".join(texts[command].replace("`", "").split()) in told and f"racerl {command} [" in told


def test_no_command_shows_the_help(run):
    done = run()
    assert done.returncode == 0 and "Usage" in done.stdout


@pytest.mark.parametrize(
    "given, expected",
    [
        (["log", "budget=smoke"], ["log", "train=['+dr=friction_0.02','budget=smoke']"]),
        (
            ["log", "train=[algo=imitation,+dr=friction_0.02]", "laps=2"],
            ["log", "laps=2", "train=['algo=imitation','+dr=friction_0.02']"],
        ),
        (["log", "train=['budget=smoke']", "dr=none"], ["log", "train=['budget=smoke','dr=none']"]),
        (["log", "gap=[vehicle=published]", "seeds=[0]"], ["log", "gap=['vehicle=published']", "seeds=[0]"]),
        (["log", "budget.actor=[8,8]"], ["log", "train=['+dr=friction_0.02','budget.actor=[8,8]']"]),
    ],
)
def test_gap_close_takes_the_words_of_train_as_they_are_typed(given, expected):
    words = gather_words("close", given, "train")
    assert words == expected
    settings = compose_settings("close", [*words[1:], "logs=[x]", "real=y"])
    trained = compose_settings("train", settings["train"])
    assert trained["budget"]["steps"] > 0


def test_what_gap_close_is_told_reaches_training(run, monkeypatch):
    told = []
    monkeypatch.setattr("racerl.cli._close", lambda settings, out: told.append(settings["train"]))
    done = run("gap", "close", ".", "real=published", "train=[algo=imitation,+dr=friction_0.02]", "budget=smoke")
    assert done.returncode == 0 and told == [["algo=imitation", "+dr=friction_0.02", "budget=smoke"]], done.stderr


@pytest.fixture
def bash(tmp_path):
    """A Bash on a terminal with racerl's completion, as --install-completion sets it up."""
    program = tmp_path / "racerl"
    program.write_text(f"#!{sys.executable}\nfrom racerl.cli import main\nmain()\n")
    program.chmod(0o755)
    environment = {**os.environ, "PATH": f"{tmp_path}:{os.environ['PATH']}", "PYTHONPATH": str(ROOT), "PS1": "$ "}
    environment |= {"TERM": "dumb", "INPUTRC": "/dev/null"}
    source = {**environment, "_RACERL_COMPLETE": "source_bash"}
    script = subprocess.run([program], env=source, capture_output=True, text=True, timeout=60).stdout
    (tmp_path / "completion.sh").write_text(script)
    (tmp_path / "drive.csv").touch()
    ours, theirs = pty.openpty()
    shell = subprocess.Popen(
        ["bash", "--norc", "--noprofile", "-i"],
        **dict.fromkeys(("stdin", "stdout", "stderr"), theirs),
        env=environment,
        cwd=tmp_path,
        start_new_session=True,
    )

    def heard(until, seconds=30.0):
        got, end = "", time.monotonic() + seconds
        while until not in got and time.monotonic() < end:
            if select.select([ours], [], [], 0.05)[0]:
                got += os.read(ours, 4096).decode().replace("\a", "")
        return got

    def typed(line, until):
        os.write(ours, f"{line}\t".encode())
        got = heard(until)
        os.write(ours, b"\x15")  # forget the line
        return got

    os.write(ours, b". ./completion.sh; echo rea''dy\n")
    assert "ready" in heard("ready")
    yield typed
    shell.kill()
    os.close(ours)
    os.close(theirs)


def test_bash_completes_what_can_be_typed(bash):
    for line, completed in {
        "racerl train dr=fric": "dr=friction_0.",
        "racerl train +dr=al": "+dr=all_0.",
        "racerl train bud": "budget=",
        "racerl evaluate controller=mp": "controller=mpc ",
        "racerl sweep abl": "ablations ",
        "racerl effects tyre_h": "tyre_heating ",
        "racerl gap pl": "plan ",
        "racerl gap close budget=sm": "budget=smoke ",
        "racerl report com": "compare ",
        "racerl track ad": "add ",
        "racerl track ov": "oval ",
        "racerl gap dri": "drive.csv ",
        "racerl train vehicle=dri": "vehicle=drive.csv ",
    }.items():
        shown = bash(line, completed)
        assert line.rpartition(" ")[0] + " " + completed in shown, (line, shown)
        if completed.endswith("="):
            assert not shown.endswith(" ")


def test_commands_of_two_words_have_help_of_their_own(run):
    for command in TWO_WORDS:
        assert f"racerl {command} [" in run(*command.split(), "--help").stdout


def test_the_next_command_can_be_run(run, tmp_path):
    """What record, data and evaluate end with is one command, quoted as a shell needs it."""
    done = run("record", "drive=race", "seconds=8", "out=my drive", "vehicle=published")
    command = done.stdout.splitlines()[-1].removeprefix("next: ")
    assert shlex.split(command) == ["racerl", "data", "my drive/log.parquet"]
    done = run(*shlex.split(command)[1:], "data.gap=0.2", "out=seen")
    command = done.stdout.splitlines()[-1].removeprefix("next: ")
    assert shlex.split(command) == ["racerl", "identify", "my drive/log.parquet", "data.gap=0.2"]
    assert done.stdout.count("next: ") == 1
    table = pd.read_parquet(tmp_path / "my drive" / "log.parquet")
    table.assign(x=1000 * table["x"], y=1000 * table["y"]).to_csv(tmp_path / "mm.csv", index=False)
    *_, mend, command = run("data", "mm.csv", "out=mm").stdout.splitlines()
    assert "mend first" in mend and command == "next: racerl data mm.csv"
    table[["t", "x", "y", "omega"]].to_csv(tmp_path / "no_yaw.csv", index=False)
    *_, why, command = run("data", "no_yaw.csv", "out=no_yaw").stdout.splitlines()
    assert "its motion cannot be fitted" in why and command == "next: racerl data no_yaw.csv"
    assert (
        _following("racerl gap plan LOG", ["a b.csv", "out=x", "data=put"], tmp_path)
        == "racerl gap plan 'a b.csv' data=put"
    )
