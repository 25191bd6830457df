"""Laps: the race driver and its human-like variant stay on the track and make way."""

import numpy as np
import pytest

from racerl.assemble import build_track
from racerl.config import compose_settings
from tests.record.conftest import drive


def place(overrides, recording):
    """Return the distance driven along the centreline in laps, and the largest offset in half-widths."""
    track = build_track(compose_settings("record", overrides))
    x, y = recording.truth[:, 0], recording.truth[:, 1]
    nearest = ((x[:, None] - track.x) ** 2 + (y[:, None] - track.y) ** 2).argmin(axis=1)
    n = (y - track.y[nearest]) * np.cos(track.yaw[nearest]) - (x - track.x[nearest]) * np.sin(track.yaw[nearest])
    s = np.unwrap(nearest * track.spacing, period=track.length)
    return (s[-1] - s[0]) / track.length, float((np.abs(n) / track.width_left[nearest]).max())


@pytest.mark.parametrize("name, laps", [("race", 3.6), ("human_like", 2.6)])
def test_laps_of_the_default_car_stay_on_the_track(name, laps):
    words = [f"drive={name}", "seconds=30"]
    recording, log = drive(*words)
    driven, widest = place(words, recording)
    assert driven > laps and widest < 1.0 and set(log["manoeuvre"]) == {name}


def test_the_human_like_hand_wavers_and_its_seed_decides_how():
    words = ["drive=human_like", "seconds=10"]
    (_, once), (_, other) = drive(*words), drive(*words, "seed=1")
    assert not np.allclose(once["delta_ref"], other["delta_ref"])


def test_a_tamer_race_is_slower():
    lap = {share: place([], drive("drive=race", "seconds=20", f"drive.share={share}")[0])[0] for share in (0.4, 0.9)}
    assert lap[0.4] < lap[0.9]
