"""Two drivers side by side: Table I and the counterpart of the paper's Fig. 6, on one self-contained page."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from racerl.errors import ConfigError, RunError
from racerl.paper import LAPS
from racerl.report.driver import ALLOWED, Driver, listed, same
from racerl.report.figures import attitude, duel
from racerl.report.flying_lap import FlyingLap
from racerl.report.page import figure, write_page
from racerl.report.report import origins, paper_rows, table_row
from racerl.run import RunFolder

CAPTION = (
    "The fastest lap of either, one that never leaves the track where there is one. Marks stand where the cars are at "
    "equal times since the line. Delta time is A's time at a place less B's: where it falls, A is gaining."
)
ATTITUDE = "The same two laps, coloured by speed."
HEADING = " Short bars are as long as a car, the dot is its nose: where one leaves the line, the car slides."
DIGITISED = (
    " The paper's laps are digitised; their speed and steering end 0.8 m before the line, the last value is held there."
)


def compare(settings: Mapping[str, Any], out: Path, outputs: Path = Path("outputs")) -> Path:
    """Write the figure and the page about the two of `settings["drivers"]`; return the page's path.

    Raises ConfigError or RunError, one line, for what cannot be compared.
    """
    words = listed(settings["drivers"])
    if len(words) != 2:
        raise ConfigError(f"drivers: {len(words)} given, two are compared ({ALLOWED}): racerl report compare A B")
    a, b = (Driver.find(word, outputs, f"{letter}: {{}}") for letter, word in zip("AB", words, strict=True))
    if not same(a.track, b.track):
        raise RunError(f"{words[0]}, {words[1]}: were driven on different tracks; race both on one with track=…")
    theirs = bool(set(words) & set(LAPS))
    paper = [] if theirs else [Driver.find(word, outputs) for word in LAPS]
    paper = [driver for driver in paper if same(driver.track, a.track)]
    folder = RunFolder.start(out, "compare", settings)
    svg = duel.draw(a.lap, b.lap, a.track, [driver.lap for driver in paper])
    caption = CAPTION + (DIGITISED if theirs or paper else "")
    page = write_page(
        folder.path,
        "compare_page.html.j2",
        headline=headline(a.lap, b.lap),
        words=words,
        rows=[table_row(a.subject), table_row(b.subject), *paper_rows()],
        figure=figure(
            folder.path / "compare.svg", "Lines, speed, delta time, steering, side slip and margin", caption, svg
        ),
        attitude=figure(
            folder.path / "attitude.svg",
            "Speed and heading",
            ATTITUDE + (HEADING if any("yaw" in lap.samples for lap in (a.lap, b.lap)) else "") + DIGITISED * theirs,
            attitude.draw([a.lap, b.lap], a.track),
        ),
        provenance=[row for driver in (a, b) for row in origins(driver.subject)],
    )
    folder.finish()
    return page


def headline(a: FlyingLap, b: FlyingLap) -> str:
    """Return whose fastest lap is faster, and by how much."""
    first, second = sorted((("A", a.time_s), ("B", b.time_s)), key=lambda lap: lap[1])
    if second[1] - first[1] < 0.0005:
        return f"A and B are equally fast: {first[1]:.3f} s"
    return f"{first[0]} is {second[1] - first[1]:.3f} s faster than {second[0]}: {first[1]:.3f} s to {second[1]:.3f} s"
