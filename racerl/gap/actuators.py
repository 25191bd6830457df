"""The actuators by themselves: what was commanded against what was measured, without any model of the car."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import siegelslopes

from racerl.gap.evidence import INSTEAD, Evidence

Array = NDArray[np.float64]
HOLD, CALM = 0.3, 0.01  # s for which a command has to stand, and share of its range by which it may move meanwhile
FEWEST, MOST = 20, 600  # settled samples, below which nothing is said, and that are kept at most
LONGEST = 0.5  # s, of a lag


def actuators(evidence: Mapping[str, Evidence]) -> dict[str, dict[str, Any]]:
    """Return what was measured where a command had settled, by actuator; those that were not logged are left out.

    `scale` and `offset`: response = scale × command + offset, by Siegel's repeated medians; `lag` in s, by which it
    follows that best, None in runs that are too short; all None of a command that never changes; `most`: the largest
    command and response in size; `command`, `response`: settled samples.
    """
    found = {}
    for name, part in evidence.items():
        shown = part.stage.outputs[0]
        asked = INSTEAD.get(shown)  # none but an actuator has a command
        if asked is None or not {asked, shown} <= set(part.columns):
            continue
        command, response = part.columns[asked], part.columns[shown]
        rows = _settled(part, command)
        if len(rows) < FEWEST or (np.ptp(command[rows]) == 0.0 and np.ptp(command) > 0.0):
            continue
        rows = rows[np.linspace(0, len(rows) - 1, min(MOST, len(rows))).astype(int)]
        found[name] = {
            "channels": [asked, shown],
            **_line(part, command, response, rows),
            "most": [float(np.abs(column).max()) for column in (command, response)],
            "command": command[rows].round(5).tolist(),
            "response": response[rows].round(5).tolist(),
        }
    return found


def _settled(evidence: Evidence, command: Array) -> NDArray[np.int64]:
    """Return the rows at which a command has stood for a while in its run."""
    back = max(1, round(HOLD / evidence.dt))
    moved = np.abs(np.diff(command, prepend=command[0]))
    moved[evidence.first] = 0.0  # a run's first row has nothing before it
    since = np.cumsum(moved)
    rows = np.flatnonzero(np.arange(len(command)) - evidence.first >= back)
    calm = since[rows] - since[rows - back] <= CALM * np.ptp(command)
    return rows[calm]


def _line(evidence: Evidence, command: Array, response: Array, rows: NDArray[np.int64]) -> dict[str, float | None]:
    """Return scale, offset and lag of the response to a command, from settled rows."""
    if np.ptp(command[rows]) == 0.0:
        return {"scale": None, "offset": None, "lag": None}
    scale, offset = siegelslopes(response[rows], command[rows])
    lag = _lag(evidence, scale * command + offset, response)
    return {"scale": float(scale), "offset": float(offset), "lag": lag}


def _lag(evidence: Evidence, wanted: Array, response: Array) -> float | None:
    """Return by how many s the response follows what was wanted: where both differ least, run by run.

    The same rows of the response count at every lag.
    """
    most = round(LONGEST / evidence.dt)
    runs = [(wanted[run], response[run]) for run in evidence.runs if run.stop - run.start > most]
    if not any(np.ptp(asked) > 0.0 for asked, _ in runs):
        return None

    def away(k: int) -> float:
        return sum(float(((shown[most:] - asked[most - k : len(asked) - k]) ** 2).sum()) for asked, shown in runs)

    return min(range(most + 1), key=away) * evidence.dt
