"""Kinematic consistency: what must agree in a log whatever the car's tyres and actuators do.

Displacement  ∫ (v_x cos ψ − v_y sin ψ, v_x sin ψ + v_y cos ψ) dt against the poses; turning ∫ r dt against the yaw.
Wheel speed   against v_x on straights, where wheels hardly slip.
Steering      by how much the yaw rate answers later than the steering angle: seconds of best correlation.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid

from racerl.data.log import POSE, VELOCITY
from racerl.gap.evidence import Evidence

Array = NDArray[np.float64]
SPAN = 50  # samples that velocities are integrated over
STRAIGHT, STEADY, MOVING = 0.2, 0.5, 0.8  # rad/s, m/s², m/s: what counts as straight, steady and moving
FEWEST = 100  # samples that a check needs
REACH = 0.3  # s, of the search for a lag


def consistency(evidence: Evidence) -> list[dict[str, Any]]:
    """Return what was compared: {what, value, expected, unit}; `expected` for a log without flaws, None if open."""
    return [*_integrals(evidence), *_wheel_speed(evidence), *_steering(evidence)]


def _integrals(evidence: Evidence) -> Iterator[dict[str, Any]]:
    """Compare integrated velocities with the poses, RMS over spans side by side."""
    have = evidence.columns
    if not {*POSE, *VELOCITY} <= set(have):
        return
    x, y, yaw, v_x, v_y, yaw_rate = (have[name] for name in (*POSE, *VELOCITY))
    rates = v_x * np.cos(yaw) - v_y * np.sin(yaw), v_x * np.sin(yaw) + v_y * np.cos(yaw), yaw_rate
    begin = np.arange(0, len(yaw) - SPAN, SPAN)
    begin = begin[evidence.first[begin] == evidence.first[begin + SPAN]]
    if not len(begin):
        return
    off = []
    for rate, shown in zip(rates, (x, y, yaw), strict=True):
        total = cumulative_trapezoid(rate, dx=evidence.dt, initial=0.0)
        off.append((total[begin + SPAN] - total[begin]) - (shown[begin + SPAN] - shown[begin]))
    noise = dict(zip((*POSE, *VELOCITY), evidence.noise_of((*POSE, *VELOCITY)).tolist(), strict=True))
    walk = np.sqrt(SPAN) * evidence.dt  # what white noise of a rate integrates to
    seconds = f"{SPAN * evidence.dt:g} s"
    yield {
        "what": f"displacement by the velocities against the poses, RMS over {seconds}",
        "value": float(np.sqrt((off[0] ** 2 + off[1] ** 2).mean())),
        "expected": float(
            np.sqrt(2 * (noise["x"] ** 2 + noise["y"] ** 2) + walk**2 * (noise["v_x"] ** 2 + noise["v_y"] ** 2))
        ),
        "unit": "m",
    }
    yield {
        "what": f"turning by the yaw rate against the yaw, RMS over {seconds}",
        "value": float(np.sqrt((off[2] ** 2).mean())),
        "expected": float(np.sqrt(2 * noise["yaw"] ** 2 + walk**2 * noise["yaw_rate"] ** 2)),
        "unit": "rad",
    }


def _wheel_speed(evidence: Evidence) -> Iterator[dict[str, Any]]:
    have = evidence.columns
    if not {"omega", "v_x", "yaw_rate"} <= set(have):
        return
    steady = np.abs(np.gradient(have["omega"], evidence.dt)) < STEADY
    rows = (np.abs(have["yaw_rate"]) < STRAIGHT) & steady & (have["v_x"] > MOVING)
    if rows.sum() >= FEWEST:
        ratio = float(np.median(have["omega"][rows] / have["v_x"][rows]))
        yield {
            "what": "wheel speed over speed on straights, median",
            "value": ratio,
            "expected": 1.0,
            "unit": "",
        }


def _steering(evidence: Evidence) -> Iterator[dict[str, Any]]:
    """Find the lag of the yaw rate behind v_x δ; tyres and yaw inertia account for some hundredths of a second."""
    have = evidence.columns
    if not {"delta", "v_x", "yaw_rate"} <= set(have):
        return
    reach = round(REACH / evidence.dt)
    rows = np.flatnonzero(have["v_x"] > MOVING)
    rows = rows[(rows - reach >= evidence.first[rows]) & (rows + reach <= evidence.last[rows])]
    if len(rows) >= FEWEST and all(np.ptp(have[name][rows]) > 0.0 for name in ("delta", "yaw_rate")):
        turn = have["v_x"] * have["delta"]
        found = [np.corrcoef(turn[rows - k], have["yaw_rate"][rows])[0, 1] for k in range(-reach, reach + 1)]
        lag = float((int(np.argmax(found)) - reach) * evidence.dt)
        yield {"what": "yaw rate behind the steering angle", "value": lag, "expected": None, "unit": "s"}
