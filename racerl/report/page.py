"""What all pages share: figures that they carry inside themselves, templates, and where the results came from."""

import itertools
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup, escape

from racerl.documents import write_text
from racerl.report.figures.style import INK, PALETTE, PAPER, WARNING

PAGE = "report.html"
PROVENANCE = ("git_sha", "cpu", "threads", "seed")  # how long it took would make each page another
# colours of figures that a page sets itself, light or dark: variables of base.html.j2
VARIABLES = {INK: "ink", "#ffffff": "page", PAPER: "muted", "#b0b0b0": "muted", "#dddddd": "line", WARNING: "warning"}
VARIABLES |= {light: f"c{i}" for i, (light, _) in enumerate(PALETTE)}

SCALES = (0.89, 1.53)  # px of a page per point of a figure, at least so that it can be read, and at most


def figure(path: Path, title: str, caption: str, svg: str) -> dict[str, str]:
    """Write a figure's file; return what a page shows of it by `figure.html.j2`."""
    write_text(path, svg)
    return {"title": title, "caption": caption, "svg": svg}


def inline(svg: str, title: str, prefix: str) -> Markup:
    """Return a figure as an element of a page: as wide as there is room, its ids its own, its colours the page's."""
    view = re.search(r'viewBox="0 0 ([0-9.]+) [^"]*"', svg)
    if view is None:
        raise ValueError(f"the figure '{title}' is no SVG with a viewBox")
    body = svg[svg.index(">", view.end()) + 1 : svg.rindex("</svg>")]
    body = re.sub(r"<(metadata|style)\b.*?</\1>", "", body, flags=re.DOTALL)
    body = re.sub(r'(\bid="|href="#|url\(#)', rf"\g<1>{prefix}", body)
    body = re.sub(r"(?<=: )#[0-9a-f]{6}\b", lambda found: _variable(found[0]), body)
    least, most = (scale * float(view[1]) for scale in SCALES)
    size = f'style="min-width: {least:.0f}px; max-width: {most:.0f}px"'
    head = f'<svg role="img" aria-label="{escape(title)}" {view[0]} {size}>'
    return Markup(f"{head}{body}</svg>")  # noqa: S704 drawn by this package, which escapes its texts


def _variable(colour: str) -> str:
    return f"var(--{VARIABLES[colour]})" if colour in VARIABLES else colour


def number(value: float | None, digits: int) -> str:
    """Return a number with so many digits behind the point: a dash for none, 0 for zero, and no other value as zero."""
    if value is None:
        return "–"
    if value == 0:
        return "0"
    least = 10.0**-digits
    return f"{value:.{digits}f}" if abs(value) >= 0.5 * least else f"{'< ' if value > 0 else '> −'}{least:.{digits}f}"


def interval(low_high: tuple[float, float] | list[float] | None, digits: int) -> str:
    """Return an interval as text; empty for none, and for one without width."""
    if not low_high or low_high[0] == low_high[1]:
        return ""
    return " … ".join(number(bound, digits) for bound in low_high)


def provenance(manifest: Mapping[str, Any]) -> dict[str, Any]:
    """Return what a page says of a run's origin, a dash where it is not known."""
    return {key: "–" if (value := manifest.get(key)) is None else value for key in PROVENANCE}


def write_page(folder: Path, template: str, **values: Any) -> Path:
    """Write a run's page from a template of this package; raise jinja2.UndefinedError where a value is missing."""
    return fill_in(folder / PAGE, template, **values)


def fill_in(path: Path, template: str, **values: Any) -> Path:
    """Write a page from a template of this package; raise jinja2.UndefinedError where a value is missing."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("racerl.report", "."),
        autoescape=True,
        trim_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    count = itertools.count(1)
    environment.filters["inline"] = lambda svg, title: inline(svg, title, f"f{next(count)}-")
    environment.globals["palette"] = PALETTE
    write_text(path, environment.get_template(template).render(**values))
    return path
