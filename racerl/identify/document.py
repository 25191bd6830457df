"""`model.yaml`: the identified vehicle as a file that every command takes, with where its numbers come from."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from racerl.data.log import runs_told
from racerl.documents import write_text
from racerl.vehicle.load import vehicle_document

DIGITS = 6  # significant ones


def write_model(
    path: Path,
    settings: Mapping[str, Any],
    changes: Mapping[str, float],
    facts: Mapping[str, Any],
    command: str = "identify",
) -> None:
    """Write the vehicle of `settings` with the values put in that a command found, each with its 95 % interval."""
    rounded = {name: float(f"{value:.{DIGITS}g}") for name, value in changes.items()}
    document = vehicle_document(settings, rounded, "wheel_speed")
    lines = [f"# {line}" for line in _provenance(facts, command)]
    place: list[str] = []
    for line in yaml.safe_dump(document, sort_keys=False).splitlines():
        key = line.split(":")[0]
        depth = (len(key) - len(key.lstrip())) // 2
        place = [*place[:depth], key.strip()]
        name = ".".join("drive" if part == "wheel_speed" else part for part in place)
        lines.append(line + _comment(facts["parameters"].get(name)))
    write_text(path, "\n".join(lines) + "\n")


def _provenance(facts: Mapping[str, Any], command: str) -> list[str]:
    logs = ", ".join(f"{log['name']} ({log['seconds']:.0f} s, {runs_told(log['runs'])})" for log in facts["logs"])
    lines = [f"Identified by racerl {command} from {logs}."]
    if facts.get("rmse"):
        last = facts["rmse"][str(facts["horizon"])]
        errors = ", ".join(
            f"{name} {'diverged' if value is None else format(value, '.3g')}" for name, value in last.items()
        )
        lines.append(f"Error of {facts['horizon']}-sample rollouts in runs that were held out: {errors}.")
    lines.append("Comments: 95 % interval; ~ = the data alone, without the prior, leave it wider than ± 5 %.")
    return lines


def _comment(parameter: Mapping[str, Any] | None) -> str:
    if parameter is None:
        return ""
    if not parameter.get("told", True):
        return f"  # not told by the log, as configured {parameter['unit']}".rstrip()
    low, high = parameter["ci95"]
    return f"  # {low:.4g} … {high:.4g}{'' if parameter['identified'] else ' ~'} {parameter['unit']}".rstrip()
