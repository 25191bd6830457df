"""Every numeric key of every command set to what is no number for it: one line, or a sensible beginning of a run.

A stage is let as far as its run folder, by which all settings have to be checked; those that drive for seconds only
(record, evaluate, a race) are let drive, too. Fails where a number is used before `bounds` has seen it.
"""

import contextlib
import signal
import traceback
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from racerl.bench.bench import bench
from racerl.config import compose_settings
from racerl.data.survey import survey
from racerl.drive.drive import drive
from racerl.errors import RacerlError
from racerl.evaluate.evaluate import evaluate
from racerl.evaluate.rivals import race
from racerl.gap.diagnose import gap
from racerl.identify.identify import identify
from racerl.optimum.optimum import optimum
from racerl.record.record import record
from racerl.report.report import report
from racerl.report.track import show_track
from racerl.run import RunFolder
from racerl.sweep.sweep import sweep
from racerl.train.close import close
from racerl.train.onward import train_onward
from racerl.train.train import train
from racerl.tune.tune import tune
from racerl.vehicle import kernel

pytestmark = pytest.mark.soak

VALUES = ["-1", "0", "nan", "inf", "1e30", "word", "null", "[]", "true"]
SECONDS = 10  # after which a run that has begun is taken for a sensible one
LONGEST = 600  # letters of a line
# command: its words, its stage, whether it takes the function that composes, and whether it is let drive
COMMANDS: dict[str, tuple[list[str], Any, bool, bool]] = {
    "train": ([], train, False, False),
    "refine": (["from={run}"], train_onward, False, False),
    "refine by evolution": (["from={run}", "budget=evolution"], train_onward, False, False),
    "evaluate": (["run={run}", "laps=1", "seeds=[0]"], evaluate, False, True),
    "race": (["controller=pure_pursuit", "laps=1", "seeds=[0]"], race, False, True),
    "record": (["seconds=20", "drive=race"], record, False, True),
    "optimum": ([], optimum, False, False),
    "identify": (["logs=[{log}]"], identify, False, False),
    "gap": (["logs=[{log}]"], gap, False, False),
    "data": (["logs=[{log}]"], survey, False, True),
    "report": (["runs=[]"], report, False, False),
    "track": ([], show_track, False, True),
    "sweep": (["name=action_space"], sweep, True, False),
    "tune": (["controller=pure_pursuit"], tune, False, False),
    "close": (["logs=[{log}]", "real=published"], close, True, False),
    "bench": (["benchmark=sim"], bench, True, False),
    "drive": (["input=script"], drive, False, False),
}


class Reached(BaseException):
    """The run would begin, or has driven for a while."""


@pytest.fixture(scope="module")
def given(smoke_run, tmp_path_factory):
    out = tmp_path_factory.mktemp("numbers") / "driven"
    record(compose_settings("record", ["drive=programme", "seconds=60", "vehicle=published"]), out)
    return {"run": str(smoke_run), "log": str(out / "log.parquet")}


def numeric(settings: Any, where: str = ""):
    """Yield the keys that hold a number, or a list of some."""
    for key, value in settings.items():
        if isinstance(value, dict):
            yield from numeric(value, f"{where}{key}.")
            continue
        numbers = value if isinstance(value, list) else [value]
        if numbers and all(isinstance(each, (int, float)) and not isinstance(each, bool) for each in numbers):
            yield where + key


@pytest.mark.parametrize("name", list(COMMANDS))
def test_one_line_or_a_sensible_run(name, given, tmp_path, monkeypatch, capsys):
    words, stage, composing, drives = COMMANDS[name]
    command = name.split()[0]
    words = [word.format(**given) for word in words]
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(kernel, "build", lambda *_: None)

    def reached(*_, **__):
        raise Reached

    if not drives:
        monkeypatch.setattr(RunFolder, "start", reached)
    before = signal.signal(signal.SIGALRM, reached)
    told, wrong = Counter(), dict[str, str]()
    cases = [(key, value) for key in numeric(compose_settings(command, words)) for value in VALUES]
    try:
        for number, (key, value) in enumerate(cases):
            signal.alarm(SECONDS)
            try:
                out = tmp_path / str(number)
                settings = compose_settings(command, [*(w for w in words if w.split("=")[0] != key), f"{key}={value}"])
                stage(settings, out, *([compose_settings] if composing else []))
                told["ran"] += 1
            except Reached:
                told["begun"] += 1
            except RacerlError as error:
                told["one line"] += 1
                if "\n" in str(error) or len(str(error)) > LONGEST:
                    wrong[f"{key}={value}"] = f"no line: {str(error)[:300]}"
            except Exception as error:
                last = traceback.extract_tb(error.__traceback__)[-1]
                place = f"{Path(last.filename).name}:{last.lineno}"
                wrong[f"{key}={value}"] = f"{type(error).__name__} in {place}: {str(error)[:150]}"
            finally:
                signal.alarm(0)
    finally:
        signal.signal(signal.SIGALRM, before)
        with contextlib.suppress(OSError):
            signal.alarm(0)
    with capsys.disabled():
        print(f"\n{name}: {len(cases)} cases, {dict(told)}")
    assert not wrong, f"{name}: {wrong}"
