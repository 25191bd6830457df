"""The page to hover over and zoom into: its numbers, its script, and what it needs."""

import json
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from racerl.errors import ConfigError
from racerl.report import interactive
from racerl.report.driver import Driver
from racerl.report.flying_lap import delta_time
from racerl.report.interactive import CHANNELS, draw, write_interactive
from racerl.report.show import show

DRIVERS = [Driver.find(word, Path("outputs")) for word in ("paper:rl", "paper:human")]
LAPS, TRACK = [driver.lap for driver in DRIVERS], DRIVERS[0].track

# what the page's own script needs of a browser, and what it asks of Plotly when a mouse is over a channel at 7 m
BROWSER = """
const asked = [];
globalThis.Plotly = {restyle: (plot, what, which) => asked.push([what, which]), relayout: () => 0};
const plot = {data: %s, layout: {xaxis: {}, yaxis: {}}, on: (name, call) => { plot.hover = call; }};
globalThis.document = {getElementById: () => plot, documentElement: {}};
globalThis.getComputedStyle = () => ({getPropertyValue: () => " #123456"});
globalThis.window = {matchMedia: () => ({matches: true, addEventListener: () => 0})};
"""
HOVER = "plot.hover({points: [{x: 7.0}]}); console.log(JSON.stringify(asked));"


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    return write_interactive(tmp_path_factory.mktemp("page"), "two laps", LAPS, TRACK).read_text()


def test_lines_and_channels_are_those_of_the_laps():
    figure = draw(LAPS, TRACK)
    edges, *drawn = figure.data[0], *figure.data[2:]
    assert edges.x[0] == edges.x[-1] and np.allclose(edges.x[:-1], TRACK["left_x_m"], atol=1e-4)
    recorded = [name for name in CHANNELS if not name.startswith("side slip")]  # the paper has none
    assert [figure.layout[f"yaxis{i or ''}"].title.text for i in (0, 2, 3, 4)] == recorded
    each = 2 + len(recorded)
    assert len(drawn) == 2 * each
    for number, lap in enumerate(LAPS):
        line, mark, speed, steering, margin, behind = drawn[number * each : (number + 1) * each]
        assert {trace.meta["lap"] for trace in (line, mark, speed, behind)} == {number} and line.name == lap.driver
        assert np.allclose(line.x, lap.samples["x"], atol=1e-4) and np.allclose(
            line.customdata, lap.samples["s"], atol=1e-4
        )
        assert np.allclose(speed.x, lap.samples["s"], atol=1e-4) and np.allclose(speed.y, lap.samples["v_x"], atol=1e-4)
        assert np.allclose(steering.y, lap.samples["delta"], atol=1e-4)
        assert np.allclose(margin.y, lap.samples["margin"], atol=1e-4)
        assert np.allclose(behind.y, delta_time(lap, LAPS[0], lap.samples["s"].to_numpy()), atol=1e-4)
    assert not np.any(drawn[each - 1].y) and drawn[-1].y[-2] > 0.2  # s, of the human behind the policy


def test_the_page_needs_nothing_from_elsewhere(page):
    assert "Plotly.newPlot" in page and not re.search(r"<(script|link|img)[^>]*(src|href)=", page)
    assert page.count("<title>two laps</title>") == 1


def test_a_name_cannot_end_the_script(tmp_path, page):
    hostile = [replace(LAPS[0], driver="</script><b>one"), LAPS[1]]
    text = write_interactive(tmp_path, "</script><b>one", hostile, TRACK).read_text()
    assert text.count("</script>") == page.count("</script>") and "<b>one" not in text


@pytest.mark.skipif(shutil.which("node") is None, reason="needs node to run the page's script")
def test_hovering_moves_the_marks_to_that_place_and_a_dark_page_has_its_colours(page):
    data = draw(LAPS, TRACK).to_plotly_json()["data"]
    script = page[page.index("const plot = document") :].split("</script>")[0].replace("const plot = ", "const same = ")
    code = (
        BROWSER % json.dumps(data)
        + script.replace("same = document.getElementById", "same = plot, there = document.getElementById")
        + HOVER
    )
    done = subprocess.run(["node", "-e", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-500:]
    (painted, drawn), (moved, marks) = json.loads(done.stdout)
    assert [data[i]["mode"] for i in marks] == ["markers", "markers"]
    for lap, x, y in zip(LAPS, moved["x"], moved["y"], strict=True):
        nearest = (lap.samples["s"] - 7.0).abs().to_numpy().argmin()
        assert (x[0], y[0]) == pytest.approx(tuple(lap.samples[["x", "y"]].iloc[nearest]), abs=1e-4)
    dark = {0: "#4ba3dc", 1: "#f0a63a"}
    assert painted["line.color"] == [dark[data[i]["meta"]["lap"]] for i in drawn]


def test_without_plotly_nothing_is_written(tmp_path, monkeypatch):
    monkeypatch.setattr(interactive, "find_spec", lambda name: None)
    words = {"drivers": ["paper:rl"], "file": "laps.gif", "interactive": True}
    with pytest.raises(ConfigError, match=r"needs plotly: in your clone, pip install -e '\.\[interactive\]'"):
        show(words, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_the_other_page_leads_to_it(tmp_path, monkeypatch):
    monkeypatch.setattr("racerl.report.show.replay.draw", lambda laps, track, moving: b"no film")  # it takes a while
    for wanted in (True, False):
        out = tmp_path / str(wanted)
        page = show({"drivers": ["paper:rl"], "file": "laps.gif", "interactive": wanted}, out).read_text()
        assert ('href="interactive.html"' in page) is wanted and (out / "interactive.html").is_file() is wanted
