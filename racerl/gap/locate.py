"""Where simulation and measurement part: errors by horizon, and maps of how fast they grow over what the car was doing.

Whether the growth depends on a condition is tested by rolling the conditions against it, all round, so that what is
alike within a stretch stays together; the false-discovery rate over all maps is held at 5 %.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import false_discovery_control

from racerl.gap.actuators import actuators
from racerl.gap.evidence import Evidence
from racerl.gap.growth import growth, segments
from racerl.gap.investigation import Investigation
from racerl.gap.kernels import StageKernels
from racerl.gap.kinematics import consistency
from racerl.gap.noise import expected_errors
from racerl.gap.problem import Problem
from racerl.gap.stage_problem import StageProblem

Array = NDArray[np.float64]
HORIZONS = (1, 5, 20, 50, 85)
BINS = 6  # of equal counts; the outer ones hold the tails, too
TAIL = 0.01
RATE = 0.05  # of false discoveries
ROUNDING = 1e-9  # of a spread
BLOWN = 1e6  # m, rad, m/s or rad/s, an error of which says that a rollout blew up
STEPS = 8  # most of a fit of initial states alone
CLUES = 8  # of maps, in the verdict


@dataclass(frozen=True)
class Condition:
    """Something the car was doing, at every row of the log."""

    title: str
    unit: str
    values: Array


def conditions(evidence: Evidence, l_f: float, l_r: float) -> dict[str, Condition]:
    """Return what the channels of a log say of its conditions (R,)."""
    have = evidence.columns
    found: dict[str, Condition] = {"time": Condition("time", "s", have["t"] - have["t"][0])}

    def add(name: str, title: str, unit: str, values: Array) -> None:
        found[name] = Condition(title, unit, values)

    if "v_x" in have:
        v_x = np.maximum(have["v_x"], 0.3)
        add("speed", "speed", "m/s", have["v_x"])
        add("a_x", "longitudinal acceleration", "m/s²", evidence.slope("v_x"))
        add("distance", "distance driven", "m", np.cumsum(np.abs(have["v_x"])) * evidence.dt)
        if "yaw_rate" in have:
            add("a_y", "lateral acceleration", "m/s²", have["v_x"] * have["yaw_rate"])
        if {"yaw_rate", "v_y"} <= set(have):
            add("alpha_r", "rear slip angle", "rad", -np.arctan((have["v_y"] - l_r * have["yaw_rate"]) / v_x))
            if "delta" in have:
                front = np.arctan((have["v_y"] + l_f * have["yaw_rate"]) / v_x)
                add("alpha_f", "front slip angle", "rad", have["delta"] - front)
        if "omega" in have:
            add("kappa", "slip ratio", "", (have["omega"] - have["v_x"]) / v_x)
    steering = next((name for name in ("delta", "delta_ref") if name in have), None)
    if steering:
        add("steering", "steering angle", "rad", have[steering])
        add("steering_rate", "steering rate", "rad/s", np.abs(evidence.slope(steering)))
    if {"x", "y", "yaw"} <= set(have):
        add("x", "place, x", "m", have["x"])
        add("y", "place, y", "m", have["y"])
        add("heading", "heading", "rad", np.angle(np.exp(1j * have["yaw"])))
    return found


def sound(errors: Array) -> NDArray[np.bool_]:
    """Return the windows (W,) in which the rollout did not blow up, from errors (T + 1, C, W)."""
    return np.asarray(np.abs(errors).max(axis=(0, 1)) < BLOWN)  # no number is not below it


def horizons(errors: Array) -> dict[str, list[float]]:
    """Return the RMS error (C,) so many samples into the windows, from errors (T + 1, C, W).

    Nothing where the rollout blew up in all of them.
    """
    errors = errors[:, :, sound(errors)]
    if errors.size == 0:
        return {}
    return {str(h): np.sqrt((errors[h] ** 2).mean(axis=1)).tolist() for h in HORIZONS if h < len(errors)}


def maps(investigation: Investigation, errors: Mapping[str, Array]) -> list[dict[str, Any]]:
    """Return a map of every stage's channels over every condition; `p` is adjusted for the number of maps."""
    found = []
    car = investigation.base.vehicle
    for name, part in errors.items():
        whole, kept = investigation.evidence[name], sound(part)
        if not kept.any():
            continue
        evidence = replace(whole, start=whole.start[kept], run=whole.run[kept])
        power = growth(part[:, :, kept], investigation.noise[name])
        for key, condition in conditions(evidence, float(car.arm), float(car.l_r)).items():
            values = segments(evidence, condition.values)
            edges = np.quantile(values, [TAIL, *np.linspace(0.0, 1.0, BINS + 1)[1:-1], 1.0 - TAIL])
            if len(np.unique(edges)) < BINS + 1:
                continue
            bins = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, BINS - 1)
            for c, channel in enumerate(evidence.observed):
                level, p = _test(np.minimum(power[:, c], np.quantile(power[:, c], 0.995)), bins)
                found.append(
                    {
                        "stage": name,
                        "channel": channel,
                        "condition": key,
                        "title": condition.title,
                        "unit": condition.unit,
                        "edges": edges.tolist(),
                        "power": level.tolist(),
                        "p": p,
                    }
                )
    adjusted = false_discovery_control([row["p"] for row in found]) if found else []
    for row, p in zip(found, adjusted, strict=True):
        row["p"] = float(p)
    return found


def _test(power: Array, bins: NDArray[np.int64]) -> tuple[Array, float]:
    """Return the mean power per bin, and the share of all N rolls that part the bins as much: 1/N or more.

    Those by little are nearly the one by nothing, and must count: where a condition changes slowly, chance leads close
    by as often as to where it is. The sums of a bin under all rolls are a circular correlation,
    Σ_j power_j 1(bin_{j + shift}).
    """
    count = np.maximum(np.bincount(bins, minlength=BINS), 1)
    inside = (bins == np.arange(BINS)[:, None]).astype(float)
    sums = np.fft.irfft(np.fft.rfft(inside) * np.conj(np.fft.rfft(power)), len(bins))
    spread = (count[:, None] * (sums / count[:, None] - power.mean()) ** 2).sum(axis=0)
    return sums[:, 0] / count, float((spread >= spread[0] * (1.0 - ROUNDING)).mean())


def clues(found: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the clearest maps as (stage, channel, condition, share, p): the bin that has most of the excess."""
    rows = []
    for row in found:
        excess = np.maximum(np.array(row["power"]) - 1.0, 0.0)
        if row["p"] > RATE or excess.max() < 1.0:
            continue
        best = int(np.argmax(excess))
        low, high = row["edges"][best], row["edges"][best + 1]
        text = f"{row['title']} {_number(low)} … {_number(high)} {row['unit']}".rstrip()
        share = float(excess[best] / excess.sum())
        rows.append(
            {key: row[key] for key in ("stage", "channel")} | {"condition": text, "share": share, "p": row["p"]}
        )
    rows.sort(key=lambda row: (-row["share"], row["p"]))
    return rows[:CLUES]


def _number(value: float) -> str:
    return f"{value:.2g}" if abs(value) < 10 else f"{value:.0f}"


def outcome(investigation: Investigation, evidence: Evidence) -> tuple[Array, Array]:
    """Return the errors (T + 1, C, W) of the refitted vehicle over a stage that was not fitted, and the noise's."""
    noise, car = evidence.noise(), investigation.base.vehicle
    stage = StageProblem.of(evidence, StageKernels(evidence, car, [], {}), car, [], noise)
    (initial,) = Problem([stage], []).fit({}, iterations=STEPS).initial
    return stage.errors({}, initial), expected_errors(stage, {}, initial, noise, investigation.seed)


def _chain(investigation: Investigation, whole: Evidence) -> dict[str, Any]:
    """Return errors by horizon where the commands drive: what the links add up to."""
    errors, floor = outcome(investigation, whole)
    return {"channels": list(whole.observed), "errors": horizons(errors), "floor": horizons(floor)}


def locate(investigation: Investigation, whole: Evidence | None) -> dict[str, Any]:
    """Return errors and maps of the refitted vehicle without further effects; `whole`: of the chain."""
    errors = investigation.base.errors()
    everything = maps(investigation, errors)
    chassis = investigation.evidence.get("chassis")
    return {
        "stages": {
            name: {
                "channels": list(investigation.evidence[name].observed),
                "windows": len(investigation.evidence[name].start),
                "noise": investigation.noise[name].tolist(),
                "errors": horizons(part),
                "floor": horizons(investigation.noise_errors[name]),
            }
            for name, part in errors.items()
        },
        "maps": everything,
        "where": clues(everything),
        "chain": _chain(investigation, whole) if whole else None,
        "actuators": actuators(investigation.evidence),
        "kinematics": consistency(chassis) if chassis else [],
    }
