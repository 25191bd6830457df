"""The track stage: checks a track for a car, draws it, and may give it a name of its own.

Writes `track.json`, its numbers, problems and warnings, and `track.svg`.
"""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from racerl import bounds
from racerl.documents import conf_folder, write_json, write_text
from racerl.env.actions import create_action
from racerl.errors import TrackError
from racerl.report.figures import track_sheet
from racerl.run import RunFolder
from racerl.track.add import Entry, checked_name, usual_name
from racerl.track.check import check, describe
from racerl.track.load import Given, load_given
from racerl.vehicle.load import load_vehicle

RESULT, PICTURE = "track.json", "track.svg"


def show_track(settings: Mapping[str, Any], out: Path) -> dict[str, Any]:
    """Check and draw a track; return what is written to track.json."""
    given = _given(settings)
    folder = RunFolder.start(out, "track", settings)
    facts = _sheet(given, settings, folder.path)
    folder.finish()
    return facts


def add_track(settings: Mapping[str, Any], out: Path) -> tuple[dict[str, Any], list[Path]]:
    """Check and draw a track and give it a name; return what is written to track.json, and the files that name it.

    Raises TrackError where a problem makes it no track for the car, or where the name is taken.
    """
    given = _given(settings)
    file = Path(str(settings["track"]["file"]))
    name = checked_name(usual_name(file) if settings["name"] is None else settings["name"])
    entry = Entry(name, given.centreline, headline(describe(given.track)))
    folder = RunFolder.start(out, "track", settings)
    facts = _sheet(given, settings, folder.path)
    written = [] if facts["problems"] else entry.write()
    folder.finish()
    if facts["problems"]:
        raise TrackError(f"track {file}: {facts['problems'][0]}; not added, picture in {out / PICTURE}")
    return facts, written


def headline(facts: Mapping[str, Any]) -> str:
    """Return a track's numbers in one line."""
    low, high = facts["width_m"]
    wide = f"{low:g} m wide" if low == high else f"{low:g} … {high:g} m wide"
    return f"{facts['length_m']:.1f} m, {facts['direction']}, {wide}, smallest radius {facts['radius_m']:.2f} m"


def _given(settings: Mapping[str, Any]) -> Given:
    scale = bounds.number("scale", settings["scale"], 1e-6, 1e6)
    given = load_given(settings["track"], conf_folder() / "track", scale)
    return given.reversed() if bounds.switch("reverse", settings["reverse"]) else given


def _sheet(given: Given, settings: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Write a track's numbers and picture; return the numbers."""
    vehicle, action = load_vehicle(settings["vehicle"]), create_action(settings["action"])
    radius = vehicle.wheelbase / math.tan(action.steering_max)
    found = check(given, radius)
    facts = {
        **describe(given.track),
        "turning_radius_m": round(radius, 3),
        "map": given.free.image.name if given.free else None,
        "problems": found.problems,
        "warnings": found.warnings,
    }
    write_text(folder / PICTURE, track_sheet.draw(given, found.marked, headline(facts)))
    write_json(folder / RESULT, facts)
    return facts
