"""What is odd about a track is told: units, bends, crossings, shared ground, walls; of the packaged ones nothing is."""

import math

import numpy as np
import pytest
from PIL import Image

from racerl.errors import ConfigError
from racerl.report.figures import track_sheet
from racerl.track.centreline import Centreline
from racerl.track.check import check, describe
from racerl.track.folder import track_file
from racerl.track.load import Given, read_given
from tests.conftest import CONF
from tests.track.test_load import write_csv, write_map
from tests.track.test_track import circle

RADIUS = 0.6  # m, on which the default car turns


def given(points, width=0.5, right=None):
    widths = np.full(len(points), width)
    centreline = Centreline(np.asarray(points), widths if right is None else right, widths)
    return Given(centreline, centreline.build("it"), None)


def ring(radius, x=0.0, points=60, turn=1):
    angle = np.arange(points) / points * 2 * np.pi * turn
    return np.stack([x + radius * np.cos(angle), radius * np.sin(angle)], axis=1)


def stadium(straight, radius, points=200):
    """Two straights, a tight turn at either end; counter-clockwise."""
    s = np.arange(points) / points * (2 * straight + 2 * math.pi * radius)
    half = straight + math.pi * radius
    t, sign = np.mod(s, half), np.where(s < half, 1.0, -1.0)
    angle = np.maximum(t - straight, 0.0) / radius
    x = np.minimum(t, straight) - straight / 2 + radius * np.sin(angle)
    return np.stack([sign * x, -sign * radius * np.cos(angle)], axis=1)


@pytest.mark.parametrize("path", sorted((CONF / "track").glob("*.csv")), ids=lambda path: path.stem)
def test_packaged_tracks_can_be_raced(path):
    found = check(read_given(path), RADIUS)
    assert not found.problems
    assert all("cannot keep to the centreline" in line for line in found.warnings)  # the paper's track has such a bend


@pytest.mark.parametrize("turn, direction", [(1, "counter-clockwise"), (-1, "clockwise")])
def test_a_ring_is_described(turn, direction):
    facts = describe(given(ring(2.0, turn=turn)).track)
    assert facts["direction"] == direction and facts["width_m"] == [1.0, 1.0]
    assert facts["length_m"] == pytest.approx(4 * math.pi, rel=1e-3)
    assert facts["radius_m"] == pytest.approx(2.0, rel=0.02)


def test_the_other_way_round_is_a_mirror_of_widths():
    right = np.linspace(0.3, 0.6, 60)
    there = given(ring(3.0), width=0.7, right=right)
    back = there.reversed()
    assert describe(back.track)["direction"] == "clockwise"
    assert np.array_equal(back.centreline.width_left, right[::-1])
    assert back.reversed().centreline.text() == there.centreline.text()


@pytest.mark.parametrize(
    "made, said",
    [
        (lambda: given(100 * ring(5.0), width=50.0), "is 100 m wide on average, 0.3 … 8 m suit a 1:10 car"),  # cm
        (lambda: given(0.05 * ring(3.0), width=0.03), "is 0.06 m wide"),
        (lambda: given(stadium(6.0, 0.1, 100), width=0.2), "0.28 m along its outer edge, this car on 0.60 m"),
        (lambda: given(eight()), "crosses itself at s = "),
    ],
)
def test_what_cannot_be_raced_is_a_problem(made, said):
    problems = check(made(), RADIUS).problems
    assert any(said in line for line in problems), problems
    assert not any("\n" in line for line in problems)


def eight():
    t = np.arange(120) / 120 * 2 * np.pi
    return np.stack([5 * np.sin(t), 3 * np.sin(2 * t)], axis=1)


def test_an_eight_is_one():
    assert describe(given(eight()).track)["direction"] == "figure of eight"


def test_a_bend_that_a_wider_line_takes_is_a_warning():
    found = check(given(stadium(6.0, 0.5, 120), width=0.45), RADIUS)
    assert not found.problems and any("turns on a radius of 0.4" in line for line in found.warnings)
    mask = found.marked["tighter than this car turns"]
    assert 0.1 < mask.mean() < 0.4
    assert not check(given(stadium(6.0, 0.5, 120), width=0.45), 0.3).warnings  # another car


def test_ground_that_two_stretches_share_is_told():
    apart = stadium(6.0, 0.8)
    assert not check(given(apart, width=0.7), RADIUS).warnings
    found = check(given(apart, width=0.9), RADIUS)
    assert any("widths overlap" in line for line in found.warnings) and not found.problems
    assert 0.2 < found.marked["shared ground"].mean() < 1.0


def test_narrow_places_and_whole_numbers_are_told():
    pinched = np.full(60, 0.5)
    pinched[30] = 0.05
    narrow = check(given(ring(5.0), width=0.2, right=pinched), RADIUS).warnings
    assert any("0.25 m wide at s = " in line for line in narrow)
    pixels = check(given(np.round(ring(90.0)), width=1.0), RADIUS).warnings
    assert any("whole numbers, as pixels are" in line for line in pixels)


def test_walls_inside_the_widths_are_told(tmp_path):
    path = write_map(tmp_path)
    assert not check(read_given(path), RADIUS).warnings
    image = np.array(Image.open(tmp_path / "ring.png"))
    image[150:, :] = np.where(np.hypot(*np.mgrid[0:150, -150:150]) * 0.05 > 5.25, 0, image[150:, :])  # half the ring
    Image.fromarray(image).save(tmp_path / "ring.png")
    found = check(read_given(path), RADIUS)
    (line,) = found.warnings
    assert line.startswith("its right edge lies up to 0.30 m") and "ring.png" in line and not found.problems
    assert found.marked["a wall inside the widths"].mean() == pytest.approx(0.5, abs=0.03)


def test_a_centreline_in_centimetres_is_read_by_its_scale(tmp_path):
    path = tmp_path / "cm.csv"
    points, right, left = (100 * table for table in circle())
    path.write_text(Centreline(points, right, left).text())
    assert check(read_given(path), RADIUS).problems
    scaled = read_given(path, scale=0.01)
    assert scaled.track.length == pytest.approx(10 * math.pi, rel=1e-3) and not check(scaled, RADIUS).problems


def test_a_picture_shows_the_map_turned_as_it_is(tmp_path):
    """The same twice, with a mark where there is something, and a map whose origin is turned."""
    read = read_given(write_map(tmp_path, origin="[7.5, -7.5, 1.5707963]"))
    mask = np.arange(len(read.track.x)) < 40
    svg = track_sheet.draw(read, {"look here": mask}, "ring")
    assert svg == track_sheet.draw(read, {"look here": mask}, "ring")
    assert "look here" in svg and "<image" in svg


def test_a_folders_track_is_its_map_then_its_centreline(tmp_path):
    with pytest.raises(ConfigError, match="holds no track"):
        track_file(tmp_path)
    table = write_csv(tmp_path / "spa_centerline.csv")
    write_csv(tmp_path / "spa_raceline.csv")
    assert track_file(tmp_path) == table
    (tmp_path / "settings.yaml").write_text("laps: 3\n")
    (tmp_path / "spa_map.yaml").write_text("image: spa.png\n")
    assert track_file(tmp_path).name == "spa_map.yaml"
    (tmp_path / "monza_map.yaml").write_text("image: monza.png\n")
    with pytest.raises(ConfigError, match=r"several tracks \(monza_map.yaml, spa_map.yaml\)"):
        track_file(tmp_path)
    with pytest.raises(ConfigError, match=r"notes\.txt: no such file"):
        track_file(tmp_path / "notes.txt")
