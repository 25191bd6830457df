"""Tracks out of a sketch: a closed spline through corners that are moved at random, until nothing about it is odd.

Each draw moves all corners of the sketch, lays a periodic cubic spline through them, and is thrown away where it turns
more tightly than it may, where it crosses itself, or where two stretches come nearer than GAP (`racerl.track.check`).
The same sketch gives the same track, digit for digit. `conf/track/` holds those of SKETCHES.
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import make_interp_spline

from racerl.errors import TrackError
from racerl.track.centreline import Centreline
from racerl.track.check import check
from racerl.track.curve import arc_length
from racerl.track.load import Given
from racerl.track.track import Array

SPACING = 0.1  # m between points of the centreline, about
GAP = 0.2  # m between the edges of two stretches, at least
TRIES = 200


@dataclass(frozen=True)
class Sketch:
    """What a track is made from; the lap begins at the first corner."""

    x: tuple[float, ...]  # m, of the corners, in the order in which they are driven
    y: tuple[float, ...]  # m
    sway: float  # m, deviation of the corners, each way
    radius: float  # m, the smallest that the centreline may turn on
    half_width: tuple[float, float]  # m, least and greatest
    swells: int  # how often a lap widens
    seed: int


SKETCHES = {
    # a ring of sweepers for high speed, wide, counter-clockwise
    "flowing": Sketch(
        x=(0, 6, 10, 8.5, 3.5, 0, -5, -8.5, -6),
        y=(-5, -5.5, -2.5, 2.5, 3, 5.5, 5, 1, -4),
        sway=1,
        radius=2,
        half_width=(0.6, 0.9),
        swells=3,
        seed=1,
    ),
    # narrow, one bend after the other, clockwise
    "technical": Sketch(
        x=(-5.2, -5, -3, -1.8, 0, 1.6, 2.6, 4.6, 4.6, 6.4, 5.6, 3.2, 1.2, -1, -3.2),
        y=(0, 3.4, 4.6, 2.6, 1.4, 2.8, 4.6, 4.2, 2, 0.6, -1.6, -1.4, -2.6, -1.2, -2.4),
        sway=0.2,
        radius=0.65,
        half_width=(0.38, 0.48),
        swells=2,
        seed=4,
    ),
    # two straights, one with a chicane, and a hairpin at their end, counter-clockwise
    "hairpin": Sketch(
        x=(-3, 0, 3, 5, 6.1, 6.3, 5, 3.4, 1.8, 0, -2, -4.6, -6, -5.2),
        y=(-1.6, -1.6, -1.5, -1.2, -0.9, 0.2, 0.5, 0.8, 1.8, 0.9, 1.9, 2.2, 0.4, -1.2),
        sway=0.12,
        radius=0.62,
        half_width=(0.45, 0.6),
        swells=1,
        seed=6,
    ),
}


def generate(sketch: Sketch) -> Centreline:
    """Return the first sound track of a sketch; raise TrackError where TRIES draws give none."""
    dice = np.random.default_rng(sketch.seed)
    for _ in range(TRIES):
        corners = np.column_stack([sketch.x, sketch.y]) + dice.normal(0.0, sketch.sway, (len(sketch.x), 2))
        centreline = _through(corners, sketch, dice.uniform(0.0, 2 * np.pi))
        if _is_sound(centreline, sketch.radius):
            return centreline
    raise TrackError(f"no sound track in {TRIES} draws; allow a smaller radius than {sketch.radius:g} m, or less sway")


def _through(corners: Array, sketch: Sketch, phase: float) -> Centreline:
    """Return points every SPACING on a spline through corners, and widths that swell along it."""
    closed = np.vstack([corners, corners[:1]])
    chord = arc_length(closed)
    spline = make_interp_spline(chord, closed, k=3, bc_type="periodic")
    fine = spline(np.linspace(0.0, chord[-1], 100 * len(corners) + 1))
    arc = arc_length(fine)
    share = np.arange(round(arc[-1] / SPACING)) / round(arc[-1] / SPACING)
    points = np.stack([np.interp(share * arc[-1], arc, axis) for axis in fine.T], axis=1)
    low, high = sketch.half_width
    width = low + (high - low) * (1 + np.cos(2 * np.pi * sketch.swells * share + phase)) / 2
    return Centreline(points, width, width)


def _is_sound(centreline: Centreline, radius: float) -> bool:
    """Return whether there is nothing odd about a track whose edges lie half a GAP further out."""
    points, right, left = centreline
    wider = Centreline(points, right + GAP / 2, left + GAP / 2)
    track = wider.build("draw")
    if track.max_curvature > 1.0 / radius:  # as most are: the quickest to see
        return False
    found = check(Given(wider, track, None), radius)
    return not found.problems and not found.warnings
