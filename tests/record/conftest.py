"""Short drives, each driven once for all tests; the truth behind the log comes with them."""

from functools import cache

import numpy as np
import pandas as pd
import pytest

from racerl.config import compose_settings
from racerl.record.record import Plan, table
from racerl.record.simulate import Recording


@cache
def drive(*overrides: str) -> tuple[Recording, pd.DataFrame]:
    """Return what was true and the log, without writing anything."""
    settings = compose_settings("record", list(overrides))
    recording = Plan.of(settings).drive()
    return recording, table(recording, **settings["smoothing"])


@pytest.fixture(scope="session")
def programme() -> tuple[Recording, pd.DataFrame]:
    """Ten minutes of the default programme: more than a round of its manoeuvres."""
    return drive("seconds=600")


def room_left(recording: Recording, floor: tuple[float, float] = (12.0, 8.0)) -> float:
    """Return the smallest distance of the centre of gravity from the floor's edge in m; negative when outside."""
    return float((np.array(floor) / 2 - np.abs(recording.truth[:, :2])).min())
