"""Generated tracks: the packaged ones come out again digit for digit, and what is generated can be raced."""

from dataclasses import replace

import numpy as np
import pytest

from racerl.errors import TrackError
from racerl.track.check import check
from racerl.track.generate import GAP, SKETCHES, generate
from racerl.track.load import Given, read_track
from tests.conftest import CONF

TURNING_RADIUS = 0.61  # m, of the default car


@pytest.mark.parametrize("name", SKETCHES)
def test_the_packaged_track_comes_out_again(name):
    assert generate(SKETCHES[name]).text() == (CONF / "track" / f"{name}.csv").read_text(encoding="utf-8")


@pytest.mark.parametrize("name", SKETCHES)
@pytest.mark.parametrize("seed", [11, 12])
def test_any_seed_gives_a_track_that_can_be_raced(name, seed):
    sketch = replace(SKETCHES[name], seed=seed)
    centreline = generate(sketch)
    track = centreline.build(name)
    found = check(Given(centreline, track, None), TURNING_RADIUS)
    assert not found.problems and not found.warnings
    assert track.max_curvature <= 1 / sketch.radius
    width = (track.width_left + track.width_right) / 2
    assert sketch.half_width[0] - 1e-3 <= width.min() < width.max() <= sketch.half_width[1] + 1e-3


def test_another_seed_gives_another_track():
    sketch = SKETCHES["hairpin"]
    assert generate(replace(sketch, seed=5)).text() != generate(sketch).text()


def test_stretches_stay_apart(monkeypatch):
    """Legs that lie nearer to each other than their edges and the gap allow are thrown away, however often."""
    hairpin = SKETCHES["hairpin"]
    legs = replace(hairpin, half_width=(0.9, 0.9), sway=0.01, radius=0.5)
    monkeypatch.setattr("racerl.track.generate.TRIES", 20)
    with pytest.raises(TrackError, match="no sound track in 20 draws"):
        generate(legs)
    assert generate(replace(legs, half_width=(0.9 - GAP, 0.9 - GAP)))


def test_the_three_are_of_different_character():
    """Fast and wide; tight and turning all the time; and one with a bend of half a turn on less than a metre."""
    flowing, technical, hairpin = (read_track(CONF / "track" / f"{name}.csv") for name in SKETCHES)
    turned = {track.name: np.abs(track.curvature).mean() for track in (flowing, technical, hairpin)}
    assert turned["flowing"] < turned["hairpin"] < turned["technical"]
    assert flowing.max_curvature < 0.4 and flowing.width_left.min() > technical.width_left.max()
    ahead = round(3.0 / hairpin.spacing)
    turn = np.convolve(np.tile(hairpin.curvature, 2), np.ones(ahead))[ahead : ahead + len(hairpin.x)] * hairpin.spacing
    assert turn.max() > 0.9 * np.pi  # within 3 m
