"""The page about a gap: verdict, pictures and proof; drawn from the files of its run folder alone."""

from functools import partial
from pathlib import Path
from typing import Any

import jinja2

from racerl.data.log import UNITS
from racerl.documents import read_json, read_yaml
from racerl.errors import DocumentError, RunError
from racerl.gap.diagnose import LOCATE, PROOF, VERDICT
from racerl.gap.sentences import PLAIN, headline, in_short, opening, why_not
from racerl.report.figures import gap_actuators, gap_channels, gap_maps, gap_path, gap_ranking, gap_stretch
from racerl.report.page import figure, provenance, write_page
from racerl.run import CONFIG, RunFolder

FOLDED = ("ranking", "maps")  # figures


def draw_gap(run: Path) -> Path:
    """Write the figures and the page of a finished diagnosis into its folder; return the page's path."""
    folder = RunFolder.open_complete(run, "gap")
    try:
        facts = read_json(folder.path / VERDICT)
        proof, located = (read_json(folder.path / name) if facts["gap"] else None for name in (PROOF, LOCATE))
        figures = {
            name: figure(folder.path / f"{name}.svg", title, caption, svg)
            for name, title, caption, svg in _drawn(facts, proof, located)
            if svg
        }
        return write_page(
            folder.path,
            "gap_page.html.j2",
            headline=headline(facts),
            opening=opening(facts),
            why_not=partial(why_not, facts),
            in_short=in_short,
            facts=facts,
            proof=proof,
            located=located,
            figures=[each for name, each in figures.items() if name not in FOLDED],
            folded=[each for name, each in figures.items() if name in FOLDED],
            units=UNITS,
            horizon=read_yaml(folder.path / CONFIG)["window"],
            provenance=provenance(folder.manifest),
        )
    except (DocumentError, OSError, ValueError, KeyError, TypeError, jinja2.UndefinedError) as error:
        raise RunError(f"{run}: is damaged ({' '.join(str(error).split())}); run racerl gap again") from error


def _drawn(
    facts: dict[str, Any], proof: dict[str, Any] | None, located: dict[str, Any] | None
) -> list[tuple[str, str, str, str | None]]:
    if proof is None or located is None:
        return []
    added = bool(facts["effects"] or facts["helped"])
    return [
        (
            "stretch",
            "Where the model misses most",
            f"The worst stretch of the {PLAIN[proof['stretch']['stage']]}: rollouts that begin at the dotted lines, "
            "each from the state estimated there, by fits that have not seen it.",
            gap_stretch.draw(proof["stretch"], UNITS, added),
        ),
        (
            "path",
            "Along the path",
            "Every rollout where it was driven, by its error over what the sensors' noise alone leaves.",
            gap_path.draw(proof["path"], added) if proof["path"] else None,
        ),
        (
            "gap",
            "The gap by channel",
            "Root-mean-square error of held-out rollouts over what the sensors' noise alone leaves.",
            gap_channels.draw(facts["gap"]["by_channel"], added),
        ),
        (
            "actuators",
            "The actuators by themselves",
            "Measured where the command had stood for 0.3 s, without any model; dotted, or a dash: response = command.",
            gap_actuators.draw(located["actuators"], UNITS),
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
