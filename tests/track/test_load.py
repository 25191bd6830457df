"""Track files: CSV layouts, ROS map sets, and every way they can be wrong."""

import logging

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from racerl.assemble import build_track as build_configured
from racerl.errors import RacerlError, TrackError
from racerl.track.load import load_track, read_track
from tests.track.test_track import circle

RESOLUTION = 0.05


def write_csv(path, right=0.5, left=0.8, delimiter=",", header="# x_m,y_m,w_tr_right_m,w_tr_left_m\n"):
    points, _, _ = circle(radius=5.0, points=120)
    rows = [delimiter.join(f"{v:.4f}" for v in (x, y, right, left)) for x, y in points]
    path.write_text(header + "\n".join(rows) + "\n")
    return path


def write_map(
    folder, right=0.5, left=0.8, saved_as="ring.png", centreline="ring_centerline.csv", swap=False, **changes
):
    """A ring track driven counter-clockwise: left is inside (radius 5 − left), right outside (5 + right)."""
    size = 300
    y, x = np.mgrid[0:size, 0:size] * RESOLUTION - 7.5
    radius = np.hypot(x + RESOLUTION / 2, y + RESOLUTION / 2)
    free = (radius > 5.0 - left) & (radius < 5.0 + right)
    Image.fromarray(np.where(free, 254, 0).astype(np.uint8)[::-1]).save(folder / saved_as)
    write_csv(folder / centreline, *((left, right) if swap else (right, left)))
    settings = {
        "image": "ring.png",
        "resolution": RESOLUTION,
        "origin": [-7.5, -7.5, 0.0],
        "negate": 0,
        "occupied_thresh": 0.65,
        "free_thresh": 0.196,
        **changes,
    }
    (folder / "ring.yaml").write_text("\n".join(f"{k}: {v}" for k, v in settings.items()))
    return folder / "ring.yaml"


@pytest.mark.parametrize(
    "delimiter, header",
    [
        (",", "# x_m, y_m, w_tr_right_m, w_tr_left_m\n"),
        (";", "x_m;y_m;w_right;w_left\n"),
        ("  ", "\ufeff"),
        (", ", ""),
    ],
)
def test_csv_layouts(tmp_path, delimiter, header):
    track = read_track(write_csv(tmp_path / "ring.csv", delimiter=delimiter, header=header))
    assert track.length == pytest.approx(2 * np.pi * 5, rel=1e-3)
    assert np.allclose(track.width_right, 0.5) and np.allclose(track.width_left, 0.8)


def test_map_set_is_read(tmp_path, caplog):
    track = read_track(write_map(tmp_path))
    assert np.allclose(track.width_right, 0.5) and np.allclose(track.width_left, 0.8) and not caplog.text


def test_left_before_right_is_noticed_in_the_image(tmp_path, caplog):
    with caplog.at_level(logging.WARNING):
        track = read_track(write_map(tmp_path, swap=True))
    assert "swapped" in caplog.text
    assert np.allclose(track.width_right, 0.5) and np.allclose(track.width_left, 0.8)


def test_a_wrong_image_name_falls_back_with_a_warning(tmp_path, caplog):
    with caplog.at_level(logging.WARNING):
        track = read_track(write_map(tmp_path, saved_as="other.png"))
    assert "using other.png" in caplog.text and np.allclose(track.width_left, 0.8)


@pytest.mark.parametrize(
    "changes, said",
    [
        ({"image": "../../etc/passwd"}, "leads out"),
        ({"resolution": 0}, "resolution"),
        ({"resolution": ".nan"}, "finite"),
        ({"origin": "[40.0, 40.0, 0.0]"}, "occupied or unknown"),
        ({"origin": "here"}, "not a number"),
        ({"negate": 1}, "occupied or unknown"),
    ],
)
def test_wrong_maps_are_refused(tmp_path, changes, said):
    with pytest.raises(RacerlError, match=said) as error:
        read_track(write_map(tmp_path, **changes))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("threshold", [0.196, 0.25])  # of ROS 1's map server, and ROS 2's
@pytest.mark.parametrize("grey, free", [(254, True), (205, False), (100, False)])
def test_cells_that_nobody_has_seen_are_no_track(tmp_path, grey, free, threshold):
    path = write_map(tmp_path, free_thresh=threshold)
    Image.new("L", (300, 300), grey).save(tmp_path / "ring.png")
    if free:
        assert np.allclose(read_track(path).width_left, 0.8)
    else:
        with pytest.raises(TrackError, match="100% of the centreline lies on occupied or unknown cells"):
            read_track(path)
        if grey == 100:
            read_track(path, {"free_thresh": 0.7, "occupied_thresh": 0.7})


def test_a_maps_settings_are_overridden(tmp_path):
    path = write_map(tmp_path, resolution=0)  # refused as it is
    track = load_track({"file": str(path), "resolution": RESOLUTION, "negate": 0}, tmp_path)
    assert np.allclose(track.width_left, 0.8)
    with pytest.raises(TrackError, match="a map has no 'resolutoin'; did you mean resolution"):
        load_track({"file": str(path), "resolutoin": RESOLUTION}, tmp_path)


def test_a_map_needs_one_centreline_and_an_image(tmp_path):
    path = write_map(tmp_path)
    write_csv(tmp_path / "ring_centerline_2.csv")
    with pytest.raises(TrackError, match="several centrelines"):
        read_track(path)
    for file in tmp_path.glob("*.csv"):
        file.unlink()
    with pytest.raises(TrackError, match="no \\*centerline"):
        read_track(path)
    write_csv(tmp_path / "ring_centerline.csv")
    (tmp_path / "ring.png").write_bytes(b"not an image")
    with pytest.raises(TrackError, match="cannot be read"):
        read_track(path)


@pytest.mark.parametrize(
    "content, said",
    [
        ("", "no points"),
        ("1,2,3\n2,3,4\n", "3 columns"),
        ("1,2,3,4\n1,2\n", "line 2"),
        ("1,2,3,4\na,b,c,d\n", "line 2"),
        ("# only a comment\n", "no points"),
        ("nan,0,1,1\n" * 20, "NaN"),
        ("1,2,3,4\n", "1 distinct"),
    ],
)
def test_wrong_csvs_are_refused(tmp_path, content, said):
    (tmp_path / "bad.csv").write_text(content)
    with pytest.raises(TrackError, match=said):
        read_track(tmp_path / "bad.csv")


def test_missing_files_and_keys():
    with pytest.raises(TrackError, match="no such file"):
        build_configured({"track": {"file": "nowhere.csv"}})
    with pytest.raises(TrackError, match="no 'file'"):
        build_configured({"track": {}})


def test_a_relative_file_is_looked_for_here_first(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_csv(tmp_path / "mine.csv")
    assert load_track({"file": "mine.csv"}, tmp_path / "elsewhere").name == "mine"


@settings(max_examples=150)
@given(st.binary(max_size=400))
def test_random_bytes_only_raise_typed_errors(tmp_path_factory, content):
    folder = tmp_path_factory.mktemp("fuzz")
    for name in ("t.csv", "t.yaml"):
        (folder / name).write_bytes(content)
        with pytest.raises(RacerlError):
            read_track(folder / name)
