"""Short drives of a hidden car and of one with an effect that the model lacks, recorded once."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from racerl.config import compose_settings
from racerl.identify.identify import identify
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


DAMPED = ["vehicle=published", "+vehicle/effect=yaw_damping", "vehicle.effects.yaw_damping.coefficient=0.5"]
FEW = "hold=['*.p_[CDE]*','*.r_*']"  # leaves eight parameters


@pytest.fixture(scope="session")
def damped(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The log of a minute's drive of the published car with a moment against its yaw rate; not to be changed."""
    out = tmp_path_factory.mktemp("recorded") / "damped"
    record(compose_settings("record", [*DAMPED, "seconds=60", "seed=1"]), out)
    return out / "log.parquet"


@dataclass(frozen=True)
class Lacking:
    """What identifying the damped car without its effect wrote, told and said of its progress."""

    facts: dict[str, Any]
    out: Path
    shares: list[float]


@pytest.fixture(scope="session")
def lacking(damped: Path, tmp_path_factory: pytest.TempPathFactory) -> Lacking:
    """An identification of a car whose model lacks an effect; tests must not change it."""
    out, shares = tmp_path_factory.mktemp("identified") / "lacking", []
    words = (FEW, "weights.yaw_rate=2")  # so that what is lacking is paid for in speeds
    facts = identify(settings_for(damped, *words), out, lambda share, remark: shares.append(share))
    return Lacking(facts, out, shares)
