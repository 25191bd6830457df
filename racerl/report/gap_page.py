"""The page about a gap: verdict, pictures and proof; drawn from the files of its run folder alone."""

import base64
from pathlib import Path
from typing import Any

import jinja2

from racerl.documents import read_json, read_yaml, write_text
from racerl.errors import DocumentError, RunError
from racerl.gap.diagnose import PROOF, VERDICT
from racerl.report.figures import gap_bars, gap_maps, gap_ranking
from racerl.run import CONFIG, RunFolder

PAGE = "report.html"
PROVENANCE = ("git_sha", "cpu", "threads", "seconds", "seed")


def draw_gap(run: Path) -> Path:
    """Write the figures and the page of a finished diagnosis into its folder; return the page's path."""
    folder = RunFolder.open_complete(run, "gap")
    try:
        facts = read_json(folder.path / VERDICT)
        proof = read_json(folder.path / PROOF) if facts["gap"] else None
        figures = [
            _figure(folder.path, name, title, caption, svg) for name, title, caption, svg in _drawn(facts, proof) if svg
        ]
        page = (
            _environment()
            .get_template("gap_page.html.j2")
            .render(
                facts=facts,
                proof=proof,
                figures=figures,
                horizon=read_yaml(folder.path / CONFIG)["window"],
                provenance={key: "–" if (value := folder.manifest.get(key)) is None else value for key in PROVENANCE},
            )
        )
    except (DocumentError, OSError, ValueError, KeyError, TypeError, jinja2.UndefinedError) as error:
        raise RunError(f"{run}: is damaged ({' '.join(str(error).split())}); run racerl gap again") from error
    write_text(folder.path / PAGE, page)
    return folder.path / PAGE


def _drawn(facts: dict[str, Any], proof: dict[str, Any] | None) -> list[tuple[str, str, str, str | None]]:
    if proof is None:
        return []
    added = bool(facts["effects"] or facts["helped"])
    return [
        (
            "gap",
            "The gap by channel",
            "Root-mean-square error of held-out rollouts over what the sensors' noise alone leaves.",
            gap_bars.draw(facts["gap"]["by_channel"], added),
        ),
        (
            "ranking",
            "Candidates",
            "What each one alone takes away of the excess error on windows that its fit has not seen; a negative share "
            "makes it larger.",
            gap_ranking.draw(facts["ranking"]),
        ),
        (
            "maps",
            "Where the error grows",
            "Squared growth of the error over 17 samples, in units of the noise, in bins of equal counts.",
            gap_maps.draw(proof["maps"]["before"], proof["maps"]["after"] if added else [], facts["where"]),
        ),
    ]


def _figure(folder: Path, name: str, title: str, caption: str, svg: str) -> dict[str, str]:
    write_text(folder / f"{name}.svg", svg)
    return {"title": title, "caption": caption, "data": base64.b64encode(svg.encode()).decode()}


def _environment() -> jinja2.Environment:
    return jinja2.Environment(
        loader=jinja2.PackageLoader("racerl.report", "."),
        autoescape=True,
        trim_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
