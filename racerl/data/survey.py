"""The data stage: reads logs, says what they hold, and keeps what the pictures are drawn from.

`data.json`          one inspection per log, and what concerns several
`log_0.parquet` …    the logs as they came out of the mapping, in the order given
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from racerl.data.inspect import compare, inspect
from racerl.data.load import load_given
from racerl.documents import write_json, write_parquet
from racerl.run import RunFolder

FACTS = "data.json"


def survey(settings: Mapping[str, Any], out: Path) -> dict[str, Any]:
    """Inspect `settings["logs"]` through `settings["data"]`, write the results into `out` and return them."""
    logs = load_given(settings)
    inspections = [inspect(log) for log in logs]
    shared = compare(logs)
    facts = {"logs": inspections, "warnings": shared}
    folder = RunFolder.start(out, "data", settings)
    for number, log in enumerate(logs):
        write_parquet(folder.path / table_name(number), log.table)
    write_json(folder.path / FACTS, facts)
    folder.finish(logs=len(logs), warnings=sum(len(log["warnings"]) for log in inspections) + len(shared))
    return facts


def table_name(number: int) -> str:
    """Return the file of the number-th log in the run folder."""
    return f"log_{number}.parquet"
