"""Fastest laps driven once more, side by side: a page to play and scrub, and a moving picture."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import to_hex
from numpy.typing import NDArray

from racerl import bounds
from racerl.documents import write_bytes
from racerl.errors import ConfigError, RunError
from racerl.report.driver import ALLOWED, Driver, listed, same
from racerl.report.figures import replay
from racerl.report.flying_lap import FlyingLap
from racerl.report.interactive import require_plotly, write_interactive
from racerl.report.page import write_page
from racerl.run import RunFolder

Array = NDArray[np.floating]
MOST = 6
DIGITS = 4


def show(settings: Mapping[str, Any], out: Path, outputs: Path = Path("outputs")) -> Path:
    """Write the pages and the moving picture of the laps of `settings["drivers"]`; return the first page's path.

    Raises ConfigError or RunError, one line, for what cannot be shown.
    """
    words = listed(settings["drivers"])
    if not 1 <= len(words) <= MOST:
        raise ConfigError(f"drivers: {len(words)} given, 1 to {MOST} are shown ({ALLOWED}): racerl show RUN…")
    moving = replay.writer(str(settings["file"]))
    if interactive := bounds.switch("interactive", settings["interactive"]):
        require_plotly()
    drivers = [Driver.find(word, outputs) for word in words]
    for word, driver in zip(words[1:], drivers[1:], strict=True):
        if not same(driver.track, drivers[0].track):
            raise RunError(f"{words[0]}, {word}: were driven on different tracks; race both on one with track=…")
    laps, track = _with_own_names(drivers), drivers[0].track
    film = replay.draw(laps, track, moving)
    folder = RunFolder.start(out, "show", settings)
    write_bytes(folder.path / str(settings["file"]), film)
    data = {
        "left": track[["left_x_m", "left_y_m"]].round(DIGITS).to_numpy().tolist(),
        "right": track[["right_x_m", "right_y_m"]].round(DIGITS).to_numpy().tolist(),
        "length": laps[0].length,
        "slides": replay.SLIDES,
        "shades": [to_hex(replay.SHADES(share)) for share in np.linspace(0.0, 1.0, 21)],
        "car": replay.CAR,
        "laps": [_numbers(lap) for lap in laps],
    }
    page = write_page(folder.path, "show_page.html.j2", headline=headline(laps), data=data, other=interactive)
    if interactive:
        write_interactive(folder.path, headline(laps), laps, track)
    folder.finish()
    return page


def _with_own_names(drivers: Sequence[Driver]) -> list[FlyingLap]:
    """Return the laps, with their runs' names in front where titles are the same."""
    count = Counter(driver.subject.title for driver in drivers)
    return [
        replace(each.lap, driver=f"{each.subject.name}: {each.lap.driver}")
        if count[each.subject.title] > 1
        else each.lap
        for each in drivers
    ]


def headline(laps: Sequence[FlyingLap]) -> str:
    """Return what is to be seen."""
    return laps[0].driver if len(laps) == 1 else f"{len(laps)} laps, the fastest in {min(x.time_s for x in laps):.3f} s"


def _until_the_line(name: str, column: Array, inside: NDArray[np.bool_], lap: FlyingLap) -> list[float]:
    """Return a column of a lap with a last row on the line: samples may end before it, or behind."""
    ends = {"t": lap.time_s, "s": lap.length}
    t = np.asarray(lap.samples["t"], float)
    last = ends[name] if name in ends else float(np.interp(lap.time_s, t, column))
    return [*np.round(column[inside], DIGITS).tolist(), round(last, DIGITS)]


def _numbers(lap: FlyingLap) -> dict[str, Any]:
    """Return a lap as the page plays it: time, place on the track and in the world, heading, speed, side slip."""
    samples = lap.samples
    columns = {"t": samples["t"], "s": samples["s"], "x": samples["x"], "y": samples["y"], "v": samples["v_x"]}
    columns |= {"yaw": replay.heading(lap), "slip": lap.side_slip()}
    inside = np.asarray((samples["s"] < lap.length) & (samples["t"] < lap.time_s))
    rows = {name: _until_the_line(name, np.asarray(column, float), inside, lap) for name, column in columns.items()}
    slip = {} if np.isfinite(rows["slip"]).all() else {"slip": None}  # not recorded
    return {"driver": lap.driver, "time": lap.time_s, **rows, **slip}
