"""The page about an identification: errors, values and pictures; drawn from the files of its run folder alone."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jinja2
import pandas as pd
import pyarrow as pa

from racerl.data.log import UNITS
from racerl.documents import read_json
from racerl.errors import DocumentError, RunError
from racerl.identify.identify import OVERLAY, RESULT, TYRES
from racerl.report.figures import overlay, residuals, tyre_curves
from racerl.report.page import figure, provenance, write_page
from racerl.run import RunFolder


def draw_identification(run: Path) -> Path:
    """Write the figures and the page of a finished identification into its folder; return the page's path."""
    folder = RunFolder.open_complete(run, "identify")
    try:
        facts = read_json(folder.path / RESULT)
        curves, windows = pd.read_parquet(folder.path / TYRES), pd.read_parquet(folder.path / OVERLAY)
        figures = [figure(folder.path / f"{name}.svg", *shown) for name, *shown in _drawn(facts, curves, windows)]
        return write_page(
            folder.path,
            "identification_page.html.j2",
            facts=facts,
            headline=headline(facts),
            horizons=_horizons(facts),
            units=UNITS,
            measure=measure,
            factor=factor,
            spread=spread,
            figures=figures,
            provenance=provenance(folder.manifest),
        )
    except (DocumentError, OSError, ValueError, KeyError, TypeError, pa.ArrowException, jinja2.UndefinedError) as error:
        raise RunError(f"{run}: is damaged ({' '.join(str(error).split())}); identify again") from error


def headline(facts: Mapping[str, Any]) -> str:
    """Return the verdict in one line."""
    verdict = facts["verdict"]
    return f"usable: {'yes' if verdict['usable'] else 'no'}, because {verdict['because']}"


def measure(error: float | None) -> str:
    """Return an error as a table shows it."""
    return "not known" if error is None else f"{error:.4f}"


def factor(row: Mapping[str, Any]) -> str:
    """Return the factor by which a channel's error changed."""
    return "–" if row["factor"] is None else f"× {row['factor']:.2f}"


def spread(parameter: Mapping[str, Any]) -> str:
    """Return how far the data alone determine a value."""
    if parameter["at_bound"]:
        return "at its bound"
    share = parameter["data_half_width"] / max(abs(parameter["value"]), 1e-12)
    return f"± {share:.1%}" if share < 0.01 else f"± {share:.0%}" if share < 1.0 else "nothing"


def _horizons(facts: Mapping[str, Any]) -> dict[str, list[tuple[str, str]]]:
    """Return {channel: (samples ahead, before → after)} of the horizons that the page folds away."""
    table = {}
    for name in facts["rmse_hold_last_state"][str(facts["horizon"])]:
        keys = [key for key in ("rmse_unfitted", "rmse") if facts.get(key)]
        table[name] = [(h, " → ".join(measure(facts[key][h][name]) for key in keys)) for h in facts[keys[0]]]
    return table


def _drawn(facts: dict[str, Any], curves: pd.DataFrame, windows: pd.DataFrame) -> list[tuple[str, str, str, str]]:
    fitted = facts["fitted"]
    return [
        (
            "overlay",
            "Measured and simulated",
            f"Rollouts of {facts['horizon']} samples in the run of median error"
            f"{', which was fitted too' if fitted else ''}. Each starts from the measured state, at a dotted line.",
            overlay.draw(windows, fitted),
        ),
        (
            "tyre_curves",
            "Tyres",
            "Force over load at the static load, pure slip. Grey: the slips that the log reached.",
            tyre_curves.draw(curves, facts["slips_covered"], fitted),
        ),
        (
            "residuals",
            "Errors at the end of the rollouts",
            f"Simulated minus measured after {facts['horizon']} samples, all runs. Beyond ± 4 deviations of the "
            f"channel, and not drawn: {_outside(facts)}.",
            residuals.draw(facts["residuals"], fitted),
        ),
    ]


def _outside(facts: dict[str, Any]) -> str:
    channels = facts["residuals"]["fitted"].items()
    return ", ".join(f"{c['outside']} of {c['outside'] + sum(c['counts'])} in {name}" for name, c in channels)
