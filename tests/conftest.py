"""Shared pieces: settings composed once, a smoke run trained once, single-threaded torch."""

import os

os.environ.setdefault("MPLBACKEND", "Agg")
# tests run side by side, one to a core; threads of one that wait for a core spin, and stop the other
for library in ("OMP", "OPENBLAS", "MKL"):
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")

import logging
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import hypothesis
import pytest
import torch

from racerl.assemble import build_track, conf_folder
from racerl.cli import main
from racerl.config import compose_settings
from racerl.documents import alone
from racerl.evaluate.evaluate import evaluate
from racerl.train.train import train

CONF = conf_folder()

hypothesis.settings.register_profile("racerl", deadline=None)  # how long an example takes is the machine's affair
hypothesis.settings.register_profile("thorough", deadline=None)  # the cases that tests/data/test_fuzz.py promises
hypothesis.settings.load_profile("racerl")


@pytest.fixture(autouse=True)
def _one_thread() -> None:
    torch.set_num_threads(1)


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., Any]:
    """Run racerl in this process and an empty folder; return exit status and what it printed."""

    def called(*words: str) -> SimpleNamespace:
        monkeypatch.setattr(sys, "argv", ["racerl", *words])
        monkeypatch.chdir(tmp_path)
        handlers, threads = logging.root.handlers[:], torch.get_num_threads()
        capsys.readouterr()
        with pytest.raises(SystemExit) as ended:
            main()
        logging.root.handlers[:] = handlers  # a command sets up logging of its own
        torch.set_num_threads(threads)
        printed = capsys.readouterr()
        return SimpleNamespace(returncode=ended.value.code, stdout=printed.out, stderr=printed.err)

    return called


@pytest.fixture(scope="session")
def once(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, Callable[[Path], None]], Path]:
    """Make a folder by a name's first asker, for the tests of all processes of this run; none may change it."""
    base = tmp_path_factory.getbasetemp()
    root = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base

    def made(name: str, make: Callable[[Path], None]) -> Path:
        with alone(root / f"{name}.lock"):
            if not (root / name).exists():
                make(base / name)
                (base / name).rename(root / name)
        return root / name

    return made


@pytest.fixture(scope="session")
def settings() -> dict[str, Any]:
    return compose_settings("train", ["dr=friction_0.02"])


@pytest.fixture(scope="session")
def smoke_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished training run of a few seconds; tests must not change it."""
    out = tmp_path_factory.mktemp("runs") / "outputs" / "train" / "smoke"
    train(compose_settings("train", ["budget=smoke", "dr=friction_0.02", "threads=1"]), out)
    return out


@pytest.fixture(scope="session")
def smoke_evaluation(smoke_run: Path) -> Path:
    """An evaluation of the smoke run; tests must not change it."""
    out = smoke_run.parent.parent / "evaluate" / "smoke"
    evaluate(compose_settings("evaluate", [f"run='{smoke_run}'", "laps=2", "seeds=[0,1]"]), out)
    return out


@pytest.fixture(scope="session")
def middle_line(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A raceline in the TUM format along the middle of the default track, at 1.4 m/s."""
    track = build_track(compose_settings("train", []))
    rows = [f"{0:.3f}; {x:.4f}; {y:.4f}; 0; 0; 1.4; 0" for x, y in zip(track.x, track.y, strict=True)]
    path = tmp_path_factory.mktemp("line") / "line.csv"
    path.write_text("# s_m; x_m; y_m; psi_rad; kappa_radpm; vx_mps; ax_mps2\n" + "\n".join(rows))
    return path
