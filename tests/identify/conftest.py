"""A short drive of a hidden car, recorded once."""

from pathlib import Path

import pytest

from racerl.config import compose_settings
from racerl.record.record import record

START = ["starts=1", "folds=2", "threads=1", "vehicle=published"]


@pytest.fixture(scope="session")
def hidden(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with log.parquet and vehicle.yaml, three minutes of a car drawn ± 20 %; tests must not change it."""
    out = tmp_path_factory.mktemp("recorded") / "hidden"
    settings = compose_settings(
        "record", ["vehicle=published", "hidden.spread=0.2", "hidden.seed=7", "seconds=180", "seed=1"]
    )
    record(settings, out)
    return out


def settings_for(log: Path, *words: str) -> dict:
    return compose_settings("identify", [f"logs=['{log}']", *START, *words])
