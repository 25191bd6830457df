"""The actuators by themselves, on commands and responses made up by hand."""

import numpy as np
import pandas as pd
import pytest

from racerl.data.log import Log
from racerl.gap.actuators import actuators
from racerl.gap.evidence import Evidence
from racerl.gap.stage import STEERING
from racerl.report.figures import gap_actuators

DT = 0.01


def steps(response, levels=(-0.3, 0.1, 0.3, 0.0, 0.2)):
    """Return the steering's evidence: a command that stands for a second at each level, and what is made of it."""
    command = np.repeat(np.tile(levels, 4), 100)
    noise = 1e-4 * np.random.default_rng(0).standard_normal(len(command))
    rows = {"t": DT * np.arange(len(command)), "delta_ref": command, "delta": response(command) + noise}
    log = Log.from_table("made", pd.DataFrame(rows | {"omega": 1.0, "run": 0}))
    return {"steering": Evidence.of([log], STEERING, 85, 0.5)}


def late(command, rows):
    return np.concatenate([np.full(rows, command[0]), command[:-rows]])


def test_scale_offset_sign_and_delay_are_told():
    told = actuators(steps(lambda command: -0.8 * late(command, 6) + 0.02))["steering"]
    assert told["scale"] == pytest.approx(-0.8, abs=1e-3) and told["offset"] == pytest.approx(0.02, abs=1e-3)
    assert told["lag"] == pytest.approx(0.06, abs=0.5 * DT)
    assert told["most"] == pytest.approx([0.3, 0.26], abs=1e-3)
    assert "-0.800 × command + 0.020 rad" in gap_actuators.draw(
        {"steering": told}, {"delta_ref": "rad", "delta": "rad"}
    )


def test_a_run_whose_command_never_changes_tells_no_delay():
    rows = [
        pd.DataFrame({"delta_ref": command, "delta": late(command, 5), "omega": 1.0, "run": run})
        for run, command in enumerate([np.full(4000, 0.1), np.repeat([-0.3, 0.1, 0.3, 0.0, 0.2] * 4, 100)])
    ]
    table = pd.concat(rows, ignore_index=True)
    table["t"], table["delta"] = DT * np.arange(len(table)), table["delta"] + 1e-4 * np.sin(np.arange(len(table)))
    evidence = {"steering": Evidence.of([Log.from_table("made", table)], STEERING, 85, 0.5)}
    assert actuators(evidence)["steering"]["lag"] == pytest.approx(0.05, abs=0.5 * DT)


def test_a_limit_bends_the_response_and_leaves_the_line():
    clipped = steps(lambda command: np.clip(command, -0.25, 0.25), levels=(-0.2, 0.1, 0.3, 0.0, 0.2, -0.1))
    told = actuators(clipped)["steering"]
    assert told["scale"] == pytest.approx(1.0, abs=0.02) and told["most"][1] == pytest.approx(0.25, abs=1e-3)


def test_a_command_that_never_changes_is_shown_beside_what_was_reached():
    told = actuators(steps(lambda command: command - 0.06, levels=(0.1,)))["steering"]
    assert told["scale"] is told["offset"] is told["lag"] is None
    assert told["most"] == pytest.approx([0.1, 0.04], abs=1e-3)
    shown = gap_actuators.draw({"steering": told}, {"delta_ref": "rad", "delta": "rad"})
    assert "always commanded: 0.1 rad" in shown and "steering: reached 0.04 rad" in shown


def test_what_never_settles_is_left_out():
    waves = steps(lambda command: command)["steering"]
    waves.columns["delta_ref"][:] = np.sin(10.0 * waves.columns["t"])
    assert actuators({"steering": waves}) == {} and actuators({}) == {}
    assert gap_actuators.draw({}, {}) is None
