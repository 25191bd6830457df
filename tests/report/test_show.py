"""Laps driven once more: the page's numbers and its script, the moving picture, and what cannot be shown."""

import io
import json
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.animation import FFMpegWriter
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from PIL import Image

from racerl.config import run_command
from racerl.documents import read_json, write_json
from racerl.errors import RacerlError
from racerl.paper import human_lap
from racerl.report.driver import Driver
from racerl.report.figures import replay
from racerl.report.figures.replay import RATES, _columns, _place, heading
from racerl.report.flying_lap import FlyingLap
from racerl.report.show import show
from tests.report.test_compare import TRACK, raced

# what the page's script needs of a browser; three frames, half a lap apart, then what stands in the table
BROWSER = """
const rows = [], made = {};
const pen = () => new Proxy({}, {get: () => () => 0, set: () => true});
const insertRow = () => {
  const cells = [];
  rows.push(cells);
  return {insertCell: () => { cells.push(element()); return cells.at(-1); }};
};
const element = () => ({style: {}, clientWidth: 600, value: "1", append: () => 0, getContext: pen, insertRow});
let frame = null;
const get = id => made[id] ??= element();
globalThis.document = {getElementById: get, createElement: element, documentElement: element()};
globalThis.window = {devicePixelRatio: 2};
globalThis.getComputedStyle = () => ({getPropertyValue: () => "#000"});
globalThis.requestAnimationFrame = f => { frame = f; };
"""
FRAMES = """
frame(0); frame(1000 * data.laps[0].time / 2); const half = rows.map(r => r.map(c => c.textContent));
frame(1000 * end);
console.log(JSON.stringify({half, end: rows.map(r => r.map(c => c.textContent)), clock: made.clock.textContent}));
"""


def shown_by_the_command(out):
    run_command("show", ["paper:rl", "paper:human", f"out={out}"], lambda settings, out: show(settings, out), "drivers")
    return out


@pytest.fixture(scope="module")
def shown(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:  # the film takes a while
        patch.setattr("racerl.report.show.replay.draw", lambda laps, track, moving: b"no film")
        return shown_by_the_command(tmp_path_factory.mktemp("show") / "out")


@pytest.fixture(scope="module")
def data(shown):
    return json.loads(re.search(r"const data = (.*);\n", (shown / "report.html").read_text())[1])


def test_the_page_has_both_laps_from_the_line_on(data):
    rl, human = (Driver.find(f"paper:{name}", Path("outputs")).lap for name in ("rl", "human"))
    assert [lap["driver"] for lap in data["laps"]] == [rl.driver, human.driver]
    for own, lap in zip(data["laps"], (rl, human), strict=True):
        assert own["time"] == lap.time_s and own["slip"] is None  # the paper does not show it
        assert own["t"][-1] == pytest.approx(lap.time_s, abs=1e-4) and own["s"][-1] == pytest.approx(
            lap.length, abs=1e-4
        )
        assert (np.diff(own["t"]) > 0.0).all() and {len(own[name]) for name in "tsxyv"} == {len(own["yaw"])}
        assert np.interp(0.0, own["s"], own["t"]) == pytest.approx(0.0, abs=1e-3)
        step = np.hypot(np.diff(own["x"]), np.diff(own["y"]))
        ahead = np.cos(own["yaw"][:-1]) * np.diff(own["x"]) + np.sin(own["yaw"][:-1]) * np.diff(own["y"])
        assert ahead.sum() > 0.98 * step.sum()


def test_a_second_of_a_lap_is_a_moving_picture():
    driver = Driver.find("paper:rl", Path("outputs"))
    film = replay.draw([replace(driver.lap, time_s=1.0)], driver.track, replay.writer("lap.gif"))
    assert Image.open(io.BytesIO(film)).n_frames == int(np.ceil(RATES[".gif"]))


@pytest.mark.slow
def test_the_moving_picture_lasts_as_long_as_the_slower_lap(data, tmp_path):
    picture = Image.open(io.BytesIO((shown_by_the_command(tmp_path / "out") / "laps.gif").read_bytes()))
    seconds = max(lap["time"] for lap in data["laps"])
    assert picture.n_frames == int(np.ceil(seconds * RATES[".gif"])) and picture.info["duration"] == 80
    assert min(picture.size) > 400


@pytest.mark.skipif(shutil.which("node") is None, reason="no JavaScript engine on this machine")
def test_the_pages_script_plays(shown, data, tmp_path):
    script = re.search("<script>(.*)</script>", (shown / "report.html").read_text(), re.DOTALL)[1]
    script = script.replace('rows = document.getElementById("rows")', "table = document.getElementById('rows')")
    script = script.replace("rows.insertRow()", "table.insertRow()")
    (tmp_path / "page.js").write_text(BROWSER + script + FRAMES)
    done = subprocess.run(["node", str(tmp_path / "page.js")], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert told["half"][0][2:] == ["–", ""] and 1.0 < float(told["half"][0][1]) < 6.0
    rl, human = data["laps"]
    assert told["end"][1][3] == f"+{human['time'] - rl['time']:.3f}" and told["clock"] == f"{human['time']:.2f} s"
    assert told["end"][0][3] == ""  # nobody is behind himself


def straight(**more):
    """A lap along y = x at 2 m/s, sliding to its right by 30°."""
    t = np.linspace(0.0, 2.0, 41)
    lap = Driver.find("paper:human", Path("outputs")).lap
    samples = lap.samples.drop(columns="yaw", errors="ignore").iloc[: len(t)]
    samples = samples.assign(t=t, s=2.0 * t, x=np.sqrt(2.0) * t, y=np.sqrt(2.0) * t, **more)
    return FlyingLap("straight", 2.0, 4.0, samples)


def test_a_sliding_car_points_into_the_turn():
    lap = straight(v_x=2.0 * np.cos(0.5), v_y=-2.0 * np.sin(0.5))
    assert lap.side_slip() == pytest.approx(np.degrees(-0.5)) and heading(lap) == pytest.approx(np.pi / 4 + 0.5)
    recorded = replace(lap, samples=lap.samples.assign(yaw=1.0))
    assert heading(recorded) == pytest.approx(1.0)
    assert heading(straight()) == pytest.approx(np.pi / 4) and np.isnan(straight().side_slip()).all()
    axis = Figure().add_subplot()
    (car,), trail = axis.fill([], []), axis.add_collection(LineCollection([]))
    for t, place in ((1.0, np.sqrt(2.0)), (9.0, 2.0 * np.sqrt(2.0))):  # it stays at the end of its lap
        _place(_columns(lap), t, trail, car)
        nose = car.get_xy()[0] - place
        assert np.arctan2(nose[1], nose[0]) == pytest.approx(np.pi / 4 + 0.5) and np.hypot(*nose) == pytest.approx(0.25)
        assert np.allclose(trail.get_segments()[-1][1], place)
        assert np.asarray(trail.get_array()) == pytest.approx(np.degrees(0.5))


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ([], "0 given, 1 to 6 are shown"),
        (["paper:rl"] * 7, "7 given"),
        (["paper:rl", "file=laps.avi"], "a name that ends with .gif or .mp4"),
        (["paper:rl", "file=../laps.gif"], "a name that ends with .gif or .mp4"),
        (["paper:nobody"], "unknown driver 'paper:nobody'"),
        (["drivers=null"], "drivers = None: a list is expected"),
    ],
)
def test_what_cannot_be_shown_is_said_before_anything_is_written(tmp_path, words, said):
    with pytest.raises(RacerlError, match=said):
        run_command("show", [*words, f"out={tmp_path / 'out'}"], lambda s, out: show(s, out), "drivers")
    assert not (tmp_path / "out").exists()


def test_drivers_of_one_title_and_strange_names_are_told_apart(tmp_path, monkeypatch):
    monkeypatch.setattr("racerl.report.show.replay.draw", lambda laps, track, moving: b"no film")  # it takes a while
    runs = [raced(tmp_path / name, human_lap()) for name in ("one", "two")]
    for run in map(Path, runs):
        write_json(run / "metrics.json", {**read_json(run / "metrics.json"), "label": "$1 </script> $2"})
    page = show({"drivers": runs, "file": "laps.gif", "interactive": False}, tmp_path / "out").read_text()
    data = json.loads(re.search(r"const data = (.*);\n", page)[1])
    assert [lap["driver"].split(":")[0] for lap in data["laps"]] == ["one", "two"]
    assert "$1 </script> $2" in data["laps"][0]["driver"] and page.count("</script>") == 1
    assert show({"drivers": runs[0], "file": "laps.gif", "interactive": False}, tmp_path / "alone").is_file()
    wide = raced(tmp_path / "wide", human_lap(), replace(TRACK, x=TRACK.x + 1.0))
    with pytest.raises(RacerlError, match="were driven on different tracks"):
        show({"drivers": [runs[0], wide], "file": "laps.gif", "interactive": False}, tmp_path / "both")


def test_a_film_needs_ffmpeg(monkeypatch, tmp_path):
    monkeypatch.setattr(FFMpegWriter, "isAvailable", classmethod(lambda cls: False))
    with pytest.raises(RacerlError, match=r"needs ffmpeg, which is not here; choose file=laps\.gif"):
        show({"drivers": ["paper:rl"], "file": "laps.mp4", "interactive": False}, tmp_path / "out")
