"""The page about logs: what a data run found, with pictures; drawn from the files of its run folder alone."""

from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow as pa

from racerl.data.survey import FACTS, table_name
from racerl.documents import read_json
from racerl.errors import DocumentError, RunError
from racerl.report.figures import coverage, log_channels, log_states
from racerl.report.page import figure, write_page
from racerl.run import RunFolder


def draw_logs(run: Path) -> Path:
    """Write the figures and the page of a finished data run into its folder; return the page's path."""
    folder = RunFolder.open_complete(run, "data")
    try:
        facts = read_json(folder.path / FACTS)
        tables = [pd.read_parquet(folder.path / table_name(number)) for number in range(len(facts["logs"]))]
        logs = [
            _section(folder.path, number, *pair) for number, pair in enumerate(zip(tables, facts["logs"], strict=True))
        ]
    except (DocumentError, OSError, ValueError, KeyError, TypeError, pa.ArrowException) as error:
        raise RunError(f"{run}: is damaged ({' '.join(str(error).split())}); inspect the logs again") from error
    git_sha = (folder.manifest.get("git_sha") or "–")[:18]
    values = {"headline": headline(facts), "logs": logs, "warnings": facts["warnings"], "git_sha": git_sha}
    return write_page(folder.path, "log_page.html.j2", **values)


def headline(facts: dict[str, Any]) -> str:
    """Return how much was driven, and how many traps were seen."""
    logs, seconds = facts["logs"], sum(log["seconds"] for log in facts["logs"])
    driven = f"{seconds:.0f} s" if seconds < 120.0 else f"{seconds / 60.0:.1f} min"
    warnings = len(facts["warnings"]) + sum(len(log["warnings"]) for log in logs)
    seen = f"{warnings or 'no'} warning{'s' * (warnings != 1)}"
    return f"{driven} of driving in {len(logs)} log{'s' * (len(logs) > 1)}, {seen}"


def _section(folder: Path, number: int, table: pd.DataFrame, facts: dict[str, Any]) -> dict[str, Any]:
    drawn = (
        ("channels", "Channels", "Thin vertical lines part the runs.", log_channels.draw(table, facts)),
        (
            "coverage",
            "Coverage",
            "Time spent at each value while the car moves (0.5 … 99.5 %); the line is the median.",
            coverage.draw(facts),
        ),
        ("states", "Where it drives", "One dot per sample while the car moves.", log_states.draw(table, facts)),
    )
    figures = [
        figure(folder / f"log_{number}_{name}.svg", title, caption, svg)
        for name, title, caption, svg in drawn
        if svg is not None
    ]
    return {**facts, "figures": figures}
