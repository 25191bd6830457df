"""What all pages share: figures that they carry inside themselves, templates, and where the results came from."""

import base64
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jinja2

from racerl.documents import write_text

PAGE = "report.html"
PROVENANCE = ("git_sha", "cpu", "threads", "seconds", "seed")


def figure(path: Path, title: str, caption: str, svg: str) -> dict[str, str]:
    """Write a figure's file; return what a page shows of it."""
    write_text(path, svg)
    return {"title": title, "caption": caption, "data": base64.b64encode(svg.encode()).decode()}


def provenance(manifest: Mapping[str, Any]) -> dict[str, Any]:
    """Return what a page says of a run's origin, a dash where it is not known."""
    return {key: "–" if (value := manifest.get(key)) is None else value for key in PROVENANCE}


def write_page(folder: Path, template: str, **values: Any) -> Path:
    """Fill in a template of this package and write the page; raise jinja2.UndefinedError where a value is missing."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("racerl.report", "."),
        autoescape=True,
        trim_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    write_text(folder / PAGE, environment.get_template(template).render(**values))
    return folder / PAGE
