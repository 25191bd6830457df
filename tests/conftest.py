"""Shared pieces: settings composed once, a smoke run trained once, single-threaded torch."""

import os

# one private kernel cache and no user configuration for the whole suite
os.environ.setdefault("MPLBACKEND", "Agg")

from pathlib import Path
from typing import Any

import hypothesis
import pytest
import torch

from racerl.assemble import conf_folder
from racerl.config import compose_settings
from racerl.evaluate.evaluate import evaluate
from racerl.train.train import train

CONF = conf_folder()

hypothesis.settings.register_profile("racerl", deadline=None)  # how long an example takes is the machine's affair
hypothesis.settings.load_profile("racerl")


@pytest.fixture(autouse=True)
def _one_thread() -> None:
    torch.set_num_threads(1)


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
