"""The site builds without a warning, from nothing but the product, and reads as the READMEs do on GitHub."""

import re
from pathlib import Path

import pytest

properdocs = pytest.importorskip("properdocs", reason="pip install -e '.[docs]' builds the site")

from markdown_it import MarkdownIt  # noqa: E402
from properdocs.commands.build import build  # noqa: E402
from properdocs.config import load_config  # noqa: E402
from properdocs.exceptions import Abort  # noqa: E402

from racerl.cli import app  # noqa: E402
from racerl.config import composed  # noqa: E402
from racerl.docs import api, commands, effects, sources  # noqa: E402
from racerl.docs.sources import ROOT, readmes  # noqa: E402
from racerl.vehicle import catalogue  # noqa: E402

COUNTED = ("li", "table", "tr", "img", "strong", "h1", "h2", "h3")


def made(folder, **settings):
    return load_config(str(ROOT / "racerl" / "docs" / "properdocs.yml"), site_dir=str(folder), **settings)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    folder = tmp_path_factory.mktemp("site")
    build(made(folder))  # aborts on a warning
    return folder


def content(page: Path) -> str:
    text = page.read_text(encoding="utf-8")
    return text[text.index('role="main"') : text.index("<footer")]


def test_every_effect_command_and_readme_has_a_page(site):
    names = [command.name or command.callback.__name__ for command in app.registered_commands if command.callback]
    pages = [place.replace("README.md", "index.html") for place in readmes()]
    pages += [f"effects/{name}.html" for name in catalogue.names()]
    pages += [f"commands/{name.replace(' ', '_')}.html" for name in names]
    assert [place for place in pages if not (site / place).is_file()] == []


def test_nothing_comes_from_elsewhere(site):
    loaded = re.compile(r'<(?:link|script|img)[^>]+(?:href|src)="(?:https?:)?//')
    assert [
        page for page in site.rglob("*.html") if "/outputs/" not in str(page) and loaded.search(page.read_text())
    ] == []


@pytest.mark.parametrize("place", readmes())
def test_pages_read_as_on_github(place, site):
    """The generator's Markdown is another one: a list without an empty line before it, say, would be a paragraph."""
    text = MarkdownIt("commonmark").enable("table").render((ROOT / place).read_text(encoding="utf-8"))
    shown = content(site / place.replace("README.md", "index.html"))
    assert {tag: shown.count(f"<{tag}") for tag in COUNTED} == {tag: text.count(f"<{tag}") for tag in COUNTED}


def test_an_effects_page_says_what_is_known_of_it(site):
    page = content(site / "effects" / "yaw_damping.html")
    assert 'href="locked_differential.html"' in page and "0 … 5 N m s" in page
    assert "bench_10103.json" in page and (site / "outputs/reference/gap/bench_10103.json").is_file()


def test_a_commands_page_has_its_settings_and_what_it_says(site):
    rival = content(site / "commands" / "evaluate.html")
    assert "racerl evaluate controller=NAME" in rival and "Settings" in rival
    said = content(site / "commands" / "gap.html")
    assert (
        "verdict: named: yaw_damping explains 100% of the excess" in said and "gap close" not in said.split("<h2")[-1]
    )


@pytest.mark.parametrize("command", ["train", "gap", "record"])
def test_settings_are_what_the_command_line_prints(command, run):
    assert run(command, "--cfg", "job").stdout.strip() == composed(command).strip()


@pytest.mark.parametrize("link", ["other.md", "README.md#else", "/README.md", "none.svg"])
def test_a_broken_link_stops_the_build(link, tmp_path, monkeypatch, caplog):
    page = tmp_path / "README.md"
    monkeypatch.setattr(sources, "readmes", lambda: {"README.md": page})
    monkeypatch.setattr(sources, "ROOT", tmp_path)
    for generated in (commands, effects, api):
        monkeypatch.setattr(generated, "pages", dict)
    page.write_text("# Here\n\n[there](README.md#here)\n")
    build(made(tmp_path / "site", nav=["README.md"]))
    page.write_text(f"# Here\n\n[there]({link})\n")
    with pytest.raises(Abort):
        build(made(tmp_path / "site", nav=["README.md"]))
    assert link.partition("#")[2] in caplog.text
