"""The page about an identification: errors, values and pictures; drawn from the files of its run folder alone."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jinja2
import pandas as pd
import pyarrow as pa

from racerl.documents import read_json
from racerl.errors import DocumentError, RunError
from racerl.identify.identify import OVERLAY, RESULT, TYRES
from racerl.report.figures import overlay, residuals, tyre_curves
from racerl.report.page import figure, provenance, write_page
from racerl.run import RunFolder

ERRORS = (
    ("rmse", "identified, in runs held out", "given vehicle"),
    ("rmse_unfitted", "before", ""),
    ("rmse_hold_last_state", "first state held", "first state held"),
)


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
            errors=error_rows(facts),
            spread=spread,
            figures=figures,
            provenance=provenance(folder.manifest),
        )
    except (DocumentError, OSError, ValueError, KeyError, TypeError, pa.ArrowException, jinja2.UndefinedError) as error:
        raise RunError(f"{run}: is damaged ({' '.join(str(error).split())}); identify again") from error


def error_rows(facts: dict[str, Any]) -> list[tuple[str, str, dict[str, float | None]]]:
    """Return (vehicle, horizon, RMSE by channel) for what was scored."""
    rows = []
    for key, fitted, scored in ERRORS:
        if facts.get(key):
            label = fitted if facts["fitted"] else scored
            rows += [(label, horizon, channels) for horizon, channels in facts[key].items()]
    return rows


def spread(parameter: Mapping[str, Any]) -> str:
    """Return how far the data alone determine a value."""
    if parameter["at_bound"]:
        return "at its bound"
    share = parameter["data_half_width"] / max(abs(parameter["value"]), 1e-12)
    return f"± {share:.1%}" if share < 0.01 else f"± {share:.0%}" if share < 1.0 else "nothing"


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
