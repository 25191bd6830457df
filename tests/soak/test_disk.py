"""Full, read-only and limited disks under every command: one line each, what was there stays, the same words go on.

Every trial has a small file system of its own, in a mount namespace; the user's cache lies in it, too. Fails where an
error of the operating system is not told in one line (`errors.refused`), where a file is written in place instead of
beside (`documents.write_bytes`), and where a run folder that a full disk left half begun is refused afterwards.
"""

import os
import shutil
import subprocess
import sys

import pytest

from racerl.config import compose_settings
from racerl.documents import conf_folder
from racerl.evaluate.evaluate import evaluate
from racerl.gap.diagnose import gap
from racerl.record.record import record
from racerl.train.train import train
from tests.train.short import ascent, refinement

UNSHARE = ["unshare", "--user", "--map-root-user", "--mount", "--kill-child"]
ALLOWED = shutil.which("unshare") and not subprocess.run([*UNSHARE, "true"], capture_output=True).returncode
pytestmark = [pytest.mark.soak, pytest.mark.skipif(not ALLOWED, reason="no file system can be mounted here")]

TRAIN = ["budget=smoke", "threads=1", "budget.steps=1024"]
COMMANDS = {
    "train": ["train", *TRAIN],
    "train onward": ["train", "from={trained}", "budget=smoke", "{refinement}", "threads=1"],
    "train onward, ascending": ["train", "from={trained}", "budget=smoke", "{ascent}", "threads=1"],
    "evaluate": ["evaluate", "{trained}", "laps=1", "seeds=[0]"],
    "race": ["evaluate", "controller=pure_pursuit", "laps=1", "seeds=[0]"],
    "record": ["record", "drive=race", "seconds=30"],
    "data": ["data", "{log}"],
    "identify": ["identify", "{log}", "fit=false"],
    "gap": ["gap", "{log}", "vehicle=published", "threads=1"],
    "gap plan": ["gap", "plan", "{log}", "vehicle=published"],
    "optimum": ["optimum", "track=oval"],
    "track": ["track", "oval"],
    "track add": ["track", "add", "{track}", "name=mine"],
    "report": ["report", "{raced}"],
    "report compare": ["report", "compare", "paper:rl", "paper:human"],
    "show": ["show", "paper:rl", "paper:human"],
    "sweep": ["sweep", "actuator_model", *TRAIN, "seeds=[0]", "cars=[model]"],
    "tune": ["tune", "pure_pursuit", "trials=2", "laps=1", "seeds=[0]"],
    "bench": ["bench", "policy"],
    "drive": ["drive", "input=script", "laps=1"],
    "gap close": [
        "gap",
        "close",
        "{gap}",
        "real={real}",
        "train=[budget=smoke]",
        "trainings=[0]",
        "laps=1",
        "seeds=[0]",
    ],
    "rerun": ["rerun", "{trained}"],
}
# what is done to the file system before, and how it is mended
TROUBLES = {
    "full": ("head -c 100M /dev/zero > fill 2>/dev/null || true", "rm fill"),
    "nearly full": ("head -c 100M /dev/zero > fill 2>/dev/null || true; truncate -s -12k fill", "rm fill"),
    "read-only": ("mount -o remount,ro .", "mount -o remount,rw ."),
    "limited": ("ulimit -f 1", "ulimit -f unlimited 2>/dev/null || true"),
}
SCRIPT = """
set -u
mount -t tmpfs -o size=24M none "$PLACE"
cd "$PLACE"
cp -r "$EARLIER" earlier
export XDG_CACHE_HOME="$PLACE/cache" TMPDIR="$PLACE"
( {trouble}
  {command} > "$SAID.out" 2>"$SAID" )
echo $? > "$SAID.status"
{mended}
diff -r "$EARLIER" earlier > "$SAID.lost" 2>&1
export XDG_CACHE_HOME="$CACHE"
{command} > "$SAID.again" 2>&1
echo $? > "$SAID.again.status"
"""


@pytest.fixture(scope="module")
def given(tmp_path_factory):
    """Return what commands read: a training, its race, a log."""
    folder = tmp_path_factory.mktemp("given")
    train(compose_settings("train", TRAIN), folder / "trained")
    evaluate(compose_settings("evaluate", [f"run={folder / 'trained'}", "laps=1", "seeds=[0]"]), folder / "raced")
    damped = ["+vehicle/effect=yaw_damping", "vehicle.effects.yaw_damping.coefficient=0.4"]
    record(compose_settings("record", ["seconds=90", "vehicle=published", *damped]), folder / "driven")
    log = folder / "driven" / "log.parquet"
    found = gap(compose_settings("gap", [f"logs=[{log}]", "vehicle=published"]), folder / "gap")
    assert found["verdict"] == "named"
    return {
        "gap": folder / "gap",
        "real": folder / "driven" / "vehicle.yaml",
        "trained": folder / "trained",
        "raced": folder / "raced",
        "log": log,
        "track": conf_folder() / "track" / "oval.csv",
        "refinement": refinement(),
        "ascent": ascent(),
    }


@pytest.mark.parametrize("trouble", list(TROUBLES))
@pytest.mark.parametrize("name", list(COMMANDS))
def test_one_line_and_nothing_lost(name, trouble, given, tmp_path):
    words = [word.format(**given) for word in COMMANDS[name]]
    quoted = " ".join(f"'{word}'" for word in [sys.executable, "-m", "racerl.cli", *words, "out=run"])
    begin, end = TROUBLES[trouble]
    script = SCRIPT.format(trouble=begin, command=quoted, mended=end if trouble != "limited" else "")
    place = tmp_path / "place"
    place.mkdir()
    environment = {
        **os.environ,
        "PLACE": str(place),
        "EARLIER": str(given["raced"]),
        "SAID": str(tmp_path / "said"),
        "CACHE": str(given["log"].parent.parent / "cache"),
    }
    subprocess.run([*UNSHARE, "bash", "-c", script], env=environment, check=True, timeout=900)
    said = (tmp_path / "said").read_text()
    status = int((tmp_path / "said.status").read_text())
    if status:  # bench and the like may need no more room than there is
        lines = said.strip().splitlines()
        assert status in (1, 2), said
        assert lines[-1].startswith("racerl: ") and "Traceback" not in said, said
        assert sum(line.startswith("racerl: ") for line in lines) == 1
    else:
        assert trouble in ("nearly full", "limited"), f"{name} went through"
    assert not (tmp_path / "said.lost").read_text()  # earlier results are as they were
    again = (tmp_path / "said.again").read_text()
    done = int((tmp_path / "said.again.status").read_text())
    assert done == 0 or (status == 0 and "already holds this very run" in again), again
