"""The page about a gap: verdict, pictures and proof; drawn from the files of its run folder alone."""

from pathlib import Path
from typing import Any

import jinja2

from racerl.data.log import CHANNELS
from racerl.documents import read_json, read_yaml
from racerl.errors import DocumentError, RunError
from racerl.gap.diagnose import LOCATE, PROOF, VERDICT
from racerl.report.figures import gap_bars, gap_maps, gap_ranking
from racerl.report.page import figure, provenance, write_page
from racerl.run import CONFIG, RunFolder

PLAIN = {"steering": "steering", "drive": "drive", "chassis": "motion"}  # stages, as they are told


def draw_gap(run: Path) -> Path:
    """Write the figures and the page of a finished diagnosis into its folder; return the page's path."""
    folder = RunFolder.open_complete(run, "gap")
    try:
        facts = read_json(folder.path / VERDICT)
        proof, located = (read_json(folder.path / name) if facts["gap"] else None for name in (PROOF, LOCATE))
        figures = [
            figure(folder.path / f"{name}.svg", title, caption, svg)
            for name, title, caption, svg in _drawn(facts, proof)
            if svg
        ]
        return write_page(
            folder.path,
            "gap_page.html.j2",
            headline=headline(facts),
            numbers=numbers_told(facts["configured"]),
            facts=facts,
            proof=proof,
            located=located,
            figures=figures,
            units={name: channel.unit for name, channel in CHANNELS.items()},
            horizon=read_yaml(folder.path / CONFIG)["window"],
            provenance=provenance(folder.manifest),
        )
    except (DocumentError, OSError, ValueError, KeyError, TypeError, jinja2.UndefinedError) as error:
        raise RunError(f"{run}: is damaged ({' '.join(str(error).split())}); run racerl gap again") from error


def headline(facts: dict[str, Any]) -> str:
    """Return the verdict as a sentence."""
    names = " and ".join(effect["name"].replace("_", " ") for effect in facts["effects"])
    gap = facts["gap"]
    share = f": it explains {gap['explained']:.0%} of the gap" if gap else ""
    sentences = {
        "none": f"Nothing is missing: {facts['reason']}",
        "under_excited": "This log cannot tell what is missing",
        "named": f"The model misses {names}{share}",
        "multiple": f"The model misses {names}{share.replace('it explains', 'together they explain')}",
        "ambiguous": f"The model misses {names}, or {' or '.join(facts['ambiguous_with']).replace('_', ' ')}",
        "unknown": "Something real is missing that no known effect explains",
    }
    return sentences[facts["verdict"]]


def numbers_told(configured: dict[str, Any]) -> list[str]:
    """Return a line for every number that was configured wrongly, and one for a refit of all that explains more."""
    lines = [
        f"{row['what']}: {abs(row['to'] / row['from'] - 1.0):.0%} {'less' if row['to'] < row['from'] else 'more'} than "
        f"configured, {row['parameter']} {row['to']:.4g} ({row['ci95'][0]:.4g} … {row['ci95'][1]:.4g}) instead of "
        f"{row['from']:.4g}; that is {row['explained']:.0%} of the gap as configured in the "
        f"{' and the '.join(PLAIN[stage] for stage in row['stages'])}"
        for row in configured["changes"]
    ]
    if lines and configured["rest"]:
        lines.append(f"a refit of all parameters around that, which model.yaml is, takes {configured['rest']:.0%} more")
    return lines


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
