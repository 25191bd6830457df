"""A track that is added is the one that was given, by its name, and nothing is written over."""

import numpy as np
import pytest

from racerl.assemble import build_track
from racerl.config import compose_settings
from racerl.documents import read_json
from racerl.errors import RacerlError, TrackError
from racerl.report.track import add_track
from racerl.track.add import checked_name, usual_name
from racerl.track.load import read_track
from tests.conftest import CONF
from tests.track.test_load import write_csv, write_map


@pytest.fixture
def add(tmp_path, monkeypatch):
    """Add a file as a track in an empty folder."""
    monkeypatch.chdir(tmp_path)

    def added(file, *words, out="out"):
        return add_track(compose_settings("track", [f"track={file}", *words]), tmp_path / out)

    return added


def test_what_is_added_is_what_was_given(add, tmp_path):
    file = write_csv(tmp_path / "my ring.csv", delimiter=";", header="x;y;r;l\n")
    facts, written = add(file)
    assert [path.as_posix() for path in written] == ["conf/track/my_ring.csv", "conf/track/my_ring.yaml"]
    assert read_json(tmp_path / "out" / "track.json") == facts and (tmp_path / "out" / "track.svg").is_file()
    file.unlink()
    track, before = build_track(compose_settings("train", ["track=my_ring"])), write_csv(file) and read_track(file)
    assert track.length == pytest.approx(before.length, rel=1e-6)
    assert np.allclose(track.width_right, before.width_right) and np.allclose(track.x, before.x, atol=1e-4)


def test_a_map_is_added_with_its_widths_the_right_way(add, tmp_path):
    facts, _ = add(write_map(tmp_path, swap=True), "name=ring")
    track = build_track(compose_settings("train", ["track=ring"]))
    assert np.allclose(track.width_right, 0.5) and np.allclose(track.width_left, 0.8)
    assert facts["map"] == "ring.png" and not facts["problems"]


def test_the_other_way_round_and_in_metres(add, tmp_path):
    add(write_csv(tmp_path / "ring.csv"), "reverse=true", "scale=0.5", "name=back")
    track = build_track(compose_settings("train", ["track=back"]))
    assert track.length == pytest.approx(5 * np.pi, rel=1e-3) and track.curvature.max() < 0
    assert np.allclose(track.width_right, 0.4) and np.allclose(track.width_left, 0.25)


def test_nothing_is_written_over(add, tmp_path):
    file = write_csv(tmp_path / "ring.csv")
    add(file)
    kept = {path: path.read_text() for path in (tmp_path / "conf").rglob("*.*")}
    add(file, out="again")  # the same once more
    write_csv(file, right=0.6)
    with pytest.raises(TrackError, match=r"name = ring: there is a track of that name \(conf/track/ring.csv\); give"):
        add(file, out="other")
    assert not (tmp_path / "other").exists()
    with pytest.raises(TrackError, match="name = oval: there is a track of that name"):
        add(file, "name=oval", out="packaged")
    add(file, "name=wider", out="wider")
    assert {path: path.read_text() for path in kept} == kept


def test_a_problem_keeps_a_track_out_and_is_drawn(add, tmp_path):
    file = write_csv(tmp_path / "ring.csv", right=20.0, left=4.0)
    with pytest.raises(TrackError, match=r"is 24 m wide on average.*not added, picture in .*track.svg") as error:
        add(file)
    assert "\n" not in str(error.value) and (tmp_path / "out" / "track.svg").is_file()
    assert not (tmp_path / "conf").exists()


@pytest.mark.parametrize("word", ["scale=0", "scale=one", "reverse=maybe", "name=a/b", "name=null_", "name=3"])
def test_words_are_checked(add, tmp_path, word):
    file = write_csv(tmp_path / "ring.csv")
    if word == "name=null_":
        assert add(file, word)[1][0].stem == "null_"
        return
    with pytest.raises(RacerlError) as error:
        add(file, word)
    assert "\n" not in str(error.value) and not (tmp_path / "conf").exists()


def test_where_the_packaged_folder_is_ones_own_the_track_is_found_from_anywhere(add, tmp_path, monkeypatch):
    """As in a clone: the table is named alone, as those are that come with racerl."""
    monkeypatch.setattr("racerl.track.add.conf_folder", lambda: tmp_path / "conf")
    add(write_csv(tmp_path / "ring.csv"))
    assert (tmp_path / "conf" / "track" / "ring.yaml").read_text().startswith("file: ring.csv  # 31.4 m")


@pytest.mark.parametrize(
    "file, name",
    [
        ("maps/spa/spa_map.yaml", "spa"),
        ("maps/spa/map.yaml", "spa"),
        ("maps/spa/centerline.csv", "spa"),
        ("spa_centreline.csv", "spa"),
        ("my track's.csv", "my_track_s"),
    ],
)
def test_names_come_from_files(tmp_path, file, name):
    assert usual_name(tmp_path / file) == name


@pytest.mark.parametrize("name", ["", "2", "a b", "../a", "file", "Null", "ä", "a" * 65, 3, None, "a\n"])
def test_names_that_nobody_could_type_are_refused(name):
    with pytest.raises(TrackError, match="give another name="):
        checked_name(name)


def test_names_of_packaged_tracks_are_fine():
    assert all(checked_name(path.stem) for path in (CONF / "track").glob("*.csv"))
