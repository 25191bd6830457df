"""What all pages share: inline figures that keep apart, follow the page's colours, and stay text; numbers as text."""

import re
import xml.etree.ElementTree as ElementTree

import pytest
from matplotlib.figure import Figure

from racerl.report.figures.style import COLOURS, INK, PALETTE, PAPER, WARNING, assign, style, to_svg
from racerl.report.page import figure, inline, interval, number, write_page


def drawn(label="lap time [s]"):
    with style():
        picture = Figure(figsize=(4.0, 3.0))
        axis = picture.subplots()
        axis.plot([0, 1], [0, 1], "o-", color=COLOURS[0], label=label)
        axis.plot([0, 1], [1, 0], "x", color=WARNING)
        axis.legend()
        return to_svg(picture)


def page(tmp_path, *svgs):
    figures = [figure(tmp_path / f"{i}.svg", f"Figure {i}", "", svg) for i, svg in enumerate(svgs)]
    values = {"headline": "So", "left_out": "", "rows": [], "sweeps": [], "remarks": [], "provenance": []}
    return write_page(tmp_path, "page.html.j2", figures=figures, **values).read_text()


def test_figures_on_one_page_share_no_id_and_refer_to_their_own(tmp_path):
    text = page(tmp_path, drawn(), drawn())
    ids = re.findall(r'\bid="([^"]*)"', text)
    assert len(ids) == len(set(ids)) > 10
    used = re.findall(r'(?:href="|url\()#([^")]*)', text)
    assert used and set(used) <= set(ids)


def test_a_figure_on_a_page_is_text_in_the_colours_of_the_page(tmp_path):
    text = page(tmp_path, drawn("a lap"))
    assert ">a lap</text>" in text and "var(--c0)" in text and "var(--ink)" in text and "var(--warning)" in text
    assert not {INK, COLOURS[0], WARNING} & set(re.findall("#[0-9a-f]{6}", text.partition("<body>")[2]))
    assert "prefers-color-scheme: dark" in text and "base64" not in text
    for name in set(re.findall(r"var\(--(\w+)\)", text)):
        assert text.count(f"--{name}:") == 2, "a light and a dark value"


def test_an_inline_figure_is_well_formed_and_has_its_own_file(tmp_path):
    page(tmp_path, drawn())
    assert (tmp_path / "0.svg").read_text() == drawn()
    element = ElementTree.fromstring(str(inline(drawn(), 'a "title"', "f1-")).replace("xlink:href", "href"))  # noqa: S314
    assert element.get("aria-label") == 'a "title"' and element.get("width") is None


def test_markup_in_a_label_is_text(tmp_path):
    assert "<script" not in page(tmp_path, drawn("<script>alert(1)</script>"))


def test_no_arm_is_red_and_no_two_are_alike():
    assert len({*COLOURS, INK, PAPER, WARNING}) == len(PALETTE) + 3
    for pair in PALETTE:
        for colour in pair:
            red, green, blue = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
            assert not (red > 150 and green < 0.5 * red and blue < 0.5 * red)


def test_one_identity_one_colour():
    found = assign({("s", "a"): "job1", ("s", "b"): "job2", ("t", "c"): "job1"})
    assert found["s", "a"] == found["t", "c"] != found["s", "b"]


@pytest.mark.parametrize(
    "value, digits, text",
    [
        (0.0, 5, "0"),
        (None, 3, "–"),
        (5.8, 3, "5.800"),
        (4e-6, 5, "< 0.00001"),
        (-4e-6, 5, "> −0.00001"),
        (-0.1, 1, "-0.1"),
    ],
)
def test_numbers_as_text(value, digits, text):
    assert number(value, digits) == text


def test_an_interval_without_width_is_not_told():
    assert interval([0.0, 0.0], 5) == "" == interval(None, 3) and interval([0.0, 0.001], 3) == "0 … 0.001"
