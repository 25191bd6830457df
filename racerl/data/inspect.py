"""What a log holds and what is wrong with it: channels, rates, noise, coverage, and the traps that can be seen.

Steering    ṙ is regressed on front and rear slip angles through saturating functions (any axle's
            characteristic is near some sum of them); the shift of δ that explains ṙ best is its lag. Dynamics of yaw
            and tyres are in the regression, so a clean log gives zero for δ, and the actuator's lag for δ_ref.
Drive       a_x likewise on the slip ratio of ω, and on the current.
Sign, unit  v_x tan δ / wheelbase against r, ω against v_x on straights, velocities against differentiated poses.

A lag is positive when the car answers later than the channel. Every warning is one line.
"""

import itertools
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from racerl.data.agreement import Comparison, compare_with_poses, differences
from racerl.data.differentiate import slope, smoothed
from racerl.data.lag import ENOUGH, MAX_LAG, Lag, best_lag, correlation_lag, reach, smoothing
from racerl.data.log import CHANNELS, POSE, VELOCITY, Log
from racerl.data.noise import LOCAL, channel_noise

Array = NDArray[np.float64]

MOVING = 0.8  # m/s, above which kinematic relations are looked at
LONG = 600.0  # s of a log that lags are looked for in
# s ahead and behind, share explained: within the first two, tyres, actuators and noise explain a lag; with less than
# the third, the log can't tell. Noise in ω − v_x makes ω look late by up to 0.04 s.
LIMITS = {
    "delta": (0.035, 0.035, 0.35),
    "delta_ref": (0.075, 0.035, 0.35),
    "omega": (0.045, 0.08, 0.7),
    "current": (0.045, 0.045, 0.35),
    "delta to curvature": (0.15, 0.02, 0.9),
    "delta_ref to curvature": (0.22, 0.02, 0.9),
}
GENTLE = 2.5  # m/s² of lateral acceleration (90 %), below which a log may show the curvature but no yaw dynamics
CLEAR = 0.6  # share of the yaw acceleration explained that shows the dynamics all the same
HELD_SHARE = 0.6  # of the samples of a measured channel that repeat the one before
CLIPPED_SHARE = 0.02  # of the samples that lie exactly at the extreme
REPEATED = 1.0  # s of identical rows that count as doubled driving
ALIKE = 20  # rows in a row that must be identical to count
MIX = np.uint64(0x9E3779B97F4A7C15)  # an odd number, 2⁶⁴ over the golden ratio
BINS = 24  # of a coverage histogram
SLIP_SCALES = (0.05, 0.15, 0.5)  # rad, of the saturating functions
RECKONED = (
    "the pose is reckoned from wheel and steering command: it shows no slip, has no v_y of its own and holds nothing "
    "of the tyres; record a measured one, by motion capture or a particle filter at 40 Hz or more"
)
ANGLES, SPEEDS = {"deg": 180 / math.pi}, {"km/h": 3.6, "mm": 1000.0}  # other units, and factors of ours to them
GAIN = 0.02  # by which a shift must raise the explained share to be believed
RATIOS = {"omega": (0.8, 1.25), "omega_ref": (0.7, 1.45)}  # to v_x on straights, within which slip and calibration lie
FOLLOWS = 0.4  # correlation of v_x and omega, below which they are along different axes
UNLIKE, LIKE, TURNED = 0.7, 0.9, 0.35  # of directions and headings, 0 … 1; rad


def inspect(log: Log, wheelbase: float | None = None) -> dict[str, Any]:
    """Return what a log holds, as plain JSON: channels, rate, runs, coverage, lags and warnings.

    `wheelbase` is the car's in m, where that is known better than to the log's mapping.
    """
    wheelbase = log.wheelbase if wheelbase is None else wheelbase
    lags, compared = _lags(log, wheelbase), compare_with_poses(log)
    if compared and compared.lag:
        lags["yaw to yaw_rate"] = compared.lag
    contradictions = list(_contradictions(compared)) if compared else []
    units = [*([] if contradictions else _heading(log)), *_signs_and_units(log, wheelbase)]
    return {
        "name": log.name,
        "rows": len(log.table),
        "seconds": round(log.seconds, 6),
        "rate_hz": round(1.0 / log.dt, 6),
        "remarks": list(log.remarks),
        "channels": {name: _channel(log, name) for name in log.channels},
        "missing": [name for name in CHANNELS if name not in log.channels],
        "runs": _runs(log),
        "gaps": _gaps(log),
        "coverage": coverage(log),
        "lags": {name: lag._asdict() for name, lag in lags.items()},
        "contradictions": contradictions,  # these are warnings, too
        "warnings": [
            *_constant(log),
            *_held(log),
            *_clipped(log),
            *units,
            *([RECKONED] if log.reckoned else []),
            *contradictions,
            *(_apart(compared) if compared else []),
            *_lag_warnings(lags, log.shift, units),
            *_doubled(log),
        ],
    }


def lines_of(inspected: Iterable[Mapping[str, Any]], kind: str) -> list[str]:
    """Return the `warnings` or `contradictions` of inspected logs, each with its log's name."""
    return [f"{each['name']}: {line}" for each in inspected for line in each[kind]]


def compare(logs: Sequence[Log]) -> list[str]:
    """Return a warning for every pair of logs that share driving."""
    warnings = []
    hashes = [(log, _stretches(log)) for log in logs]
    for i, (first, rows) in enumerate(hashes):
        for second, others in hashes[i + 1 :]:
            shared = _seconds(np.isin(rows, others), first)
            if shared >= REPEATED:
                warnings.append(f"{first.name} and {second.name} share {shared:.1f} s of identical rows; keep one")
    return warnings


def _channel(log: Log, name: str) -> dict[str, Any]:
    values = log.array(name)
    changes = sum(int(np.count_nonzero(np.diff(run[name]))) for run in log.runs())
    return {
        "unit": CHANNELS[name].unit,
        "min": float(values.min()),
        "max": float(values.max()),
        "mean": float(values.mean()),
        "std": float(values.std()),
        "noise": noise(log, name),
        "updates_hz": round(changes / log.seconds, 3),
    }


def noise(log: Log, name: str) -> float | None:
    """Return the standard deviation of a channel's noise, None when it is held or constant, or the runs too short."""
    unwrap = np.unwrap if name == "yaw" else np.asarray
    runs = [np.asarray(unwrap(run[name].to_numpy()), float) for run in log.runs()]
    steps = np.concatenate([np.diff(run, n=3) for run in runs])
    told = max(map(len, runs)) > LOCAL and np.median(np.abs(steps)) > 0.0
    return channel_noise(runs) if told else None


def _runs(log: Log) -> list[dict[str, Any]]:
    return [
        {"run": int(run["run"].iloc[0]), "start_s": float(run["t"].iloc[0]), "seconds": round(len(run) * log.dt, 6)}
        for run in log.runs()
    ]


def _gaps(log: Log) -> list[dict[str, float]]:
    """Return the pauses between runs that follow each other in time."""
    ends = [(float(run["t"].iloc[0]), float(run["t"].iloc[-1])) for run in log.runs()]
    return [
        {"after_s": before[1], "seconds": round(after[0] - before[1], 6)}
        for before, after in itertools.pairwise(ends)
        if after[0] - before[1] > 1.5 * log.dt
    ]


def states(log: Log) -> dict[str, Array]:
    """Return the quantities whose range decides what a log can teach, each (rows,)."""
    table = log.table
    found: dict[str, Array] = {}
    if "v_x" not in table:
        return found
    v_x = log.array("v_x")
    found["speed"] = v_x
    driving = np.maximum(np.abs(v_x), MOVING / 2)
    v_y = log.array("v_y") if "v_y" in table else np.zeros_like(v_x)
    r = log.array("yaw_rate") if "yaw_rate" in table else np.zeros_like(v_x)
    if "v_y" in table:
        found["slip_angle"] = np.arctan2(v_y, driving)
    if "omega" in table:
        found["slip_ratio"] = (log.array("omega") - v_x) / driving
    v_x_dot, v_y_dot = (
        np.concatenate(
            [slope(run[name].to_numpy(), log.dt) if name in run else np.zeros(len(run)) for run in log.runs()]
        )
        for name in ("v_x", "v_y")
    )
    if "yaw_rate" in table:
        found["a_x"] = v_x_dot - v_y * r
        found["a_y"] = v_y_dot + v_x * r
    return found


STATE_UNITS = {"speed": "m/s", "slip_angle": "rad", "slip_ratio": "", "a_x": "m/s²", "a_y": "m/s²"}


def coverage(log: Log) -> dict[str, Any]:
    """Return percentiles and a histogram of each state, over rows where the car moves."""
    found = states(log)
    moving = found["speed"] > MOVING / 2 if "speed" in found else np.ones(len(log.table), dtype=bool)
    result = {}
    for name, values in found.items():
        values = values[moving]
        if len(values) < 10:
            continue
        low, high = np.percentile(values, [0.5, 99.5])
        counts, edges = np.histogram(values, bins=BINS, range=(low, max(high, low + 1e-9)))
        result[name] = {
            "unit": STATE_UNITS[name],
            "percentiles": {str(p): float(np.percentile(values, p)) for p in (1, 5, 25, 50, 75, 95, 99)},
            "edges": edges.tolist(),
            "seconds": (counts * log.dt).tolist(),
        }
    return result


def _moving(log: Log) -> NDArray[np.bool_]:
    return log.array("v_x") > MOVING if "v_x" in log.table else np.zeros(len(log.table), dtype=bool)


def _has(log: Log, *names: str) -> bool:
    return all(name in log.table for name in names)


# ---- lags


def _share(log: Log) -> Log:
    """Return a long log's even share of minutes: lags are known from them as well."""
    every = math.ceil(log.seconds / LONG)
    if every < 2:
        return log
    minute = np.arange(len(log.table)) // round(0.1 * LONG / log.dt)
    run = pd.factorize(log.table["run"])[0] * (minute[-1] + 1) + minute
    return replace(log, table=log.table.assign(run=run)[minute % every == 0])


def _lags(log: Log, wheelbase: float) -> dict[str, Lag]:
    log = _share(log)
    lags: dict[str, Lag | None] = {}
    for name in ("delta", "delta_ref"):
        if _has(log, *VELOCITY, name):
            lag = steering_lag(log, name, wheelbase)
            if _is_gentle(log) and (lag is None or lag.best < CLEAR):
                lags[f"{name} to curvature"] = curvature_lag(log, name, wheelbase)
            else:
                lags[name] = lag
    held = {name for name, _ in _slow(log)}
    if _has(log, *VELOCITY, "omega") and "omega" not in held:
        lags["omega"] = wheel_lag(log)
    if _has(log, *VELOCITY, "current") and "current" not in held:
        lags["current"] = current_lag(log)
    if _has(log, "delta", "delta_ref"):
        lags["delta_ref to delta"] = correlation_lag(log, "delta_ref", "delta")
    return {name: lag for name, lag in lags.items() if lag is not None}


def steering_lag(log: Log, name: str, wheelbase: float) -> Lag | None:
    """Return how much later the car yaws than a steering channel says; None when the log can't tell."""

    def known(run: pd.DataFrame, speed: Array) -> tuple[Array, Array, Array]:
        v_y, r, half = run["v_y"].to_numpy(), run["yaw_rate"].to_numpy(), wheelbase / 2
        front, rear = np.arctan2(v_y + half * r, speed), np.arctan2(v_y - half * r, speed)
        return front, np.column_stack([_bank(-rear), front]), slope(r, log.dt, smoothing(log))

    def slips(angle: Array, front: Array, speed: Array) -> Array:
        # the angle itself besides, so that a wrong scale of it does no harm
        return np.column_stack([_bank(angle - front), angle])

    return _regression_lag(log, name, known, slips)


def _is_gentle(log: Log) -> bool:
    moving = _moving(log)
    lateral = np.abs(log.array("v_x") * log.array("yaw_rate"))[moving]
    return len(lateral) > 0 and float(np.percentile(lateral, 90)) < GENTLE


def curvature_lag(log: Log, name: str, wheelbase: float) -> Lag | None:
    """Return how much later the yaw rate moves than v_x tan δ / wheelbase; None when the log can't tell."""
    kinematic = log.table.assign(kinematic=log.array("v_x") * np.tan(log.array(name)) / wheelbase)
    return correlation_lag(replace(log, table=kinematic), "kinematic", "yaw_rate")


def wheel_lag(log: Log) -> Lag | None:
    """Return how much later the car accelerates than the slip of its wheels says; None when the log can't tell."""

    def slips(omega: Array, v_x: Array, speed: Array) -> Array:
        return _bank((omega - v_x) / speed)

    return _regression_lag(log, "omega", _longitudinal(log), slips)


def current_lag(log: Log) -> Lag | None:
    """Return how much later the car accelerates than the motor's current says; None when the log can't tell."""

    def torque(current: Array, v_x: Array, speed: Array) -> Array:
        return current[:, None]

    return _regression_lag(log, "current", _longitudinal(log), torque)


Known = Callable[[pd.DataFrame, Array], tuple[Array, Array, Array]]
Shifted = Callable[[Array, Array, Array], Array]


def _longitudinal(log: Log) -> Known:
    """Return what a_x depends on besides the drive: speed (drag), and v_y r and r² (the front axle in curves)."""

    def known(run: pd.DataFrame, speed: Array) -> tuple[Array, Array, Array]:
        v_x, v_y, r = (run[channel].to_numpy() for channel in VELOCITY)
        smooth = smoothed(v_x, smoothing(log))
        return smooth, np.column_stack([v_x, v_y * r, r * r]), slope(v_x, log.dt, smoothing(log)) - v_y * r

    return known


def _regression_lag(log: Log, name: str, known: Known, shifted: Shifted) -> Lag | None:
    """Return the shift of a channel with which an acceleration is explained best.

    `known(run, speed)` gives what the shifted features need, further features (rows, K) and the acceleration (rows,);
    `shifted(channel, needed, speed)` gives the features to shift, which must raise the acceleration.
    """
    most, parts = reach(log), []
    for run in log.runs():
        if len(run) < 4 * most:
            continue
        v_x, signal = run["v_x"].to_numpy(), run[name].to_numpy()
        inner = np.flatnonzero(v_x[most : len(run) - most] > MOVING) + most
        speed = np.maximum(v_x, MOVING / 2)
        needed, rest, target = (values[inner] for values in known(run, speed))
        parts.append((smoothed(signal, smoothing(log)), inner, speed[inner], needed, rest, target))
    target = np.concatenate([part[-1] for part in parts]) if parts else np.zeros(0)
    if len(target) < ENOUGH or target.std() < 1e-2 or np.concatenate([part[0] for part in parts]).std() < 5e-3:
        return None
    scores = []
    for shift in range(-most, most + 1):
        rows = [
            np.hstack([shifted(signal[inner - shift], needed, speed), rest])
            for signal, inner, speed, needed, rest, _ in parts
        ]
        scores.append(_explained(np.vstack(rows), target, shifted(np.full(1, 1e-3), np.zeros(1), np.ones(1))[0]))
    return best_lag(scores, log.dt)


def _bank(slip: Array) -> Array:
    """Return saturating functions of a slip, (rows, scales)."""
    return np.stack([np.tanh(slip / scale) for scale in SLIP_SCALES], axis=1)


def _explained(features: Array, target: Array, small: Array) -> float:
    """Return the share of the target's variance that a linear fit explains.

    It is zero when a `small` positive step of the first features lowers the target, as no tyre and no motor does.
    """
    spread = features.std(axis=0)
    scale = np.where(spread > 1e-6, spread, np.inf)  # what does not vary explains nothing
    matrix = (features - features.mean(axis=0)) / scale
    centred = target - target.mean()
    gram = matrix.T @ matrix
    weights = np.linalg.solve(gram + 1e-6 * len(target) * np.eye(len(gram)), matrix.T @ centred)
    if small @ (weights / scale)[: len(small)] <= 0.0:
        return 0.0
    return max(0.0, float(1.0 - np.var(centred - matrix @ weights) / np.var(target)))


def _lag_warnings(lags: dict[str, Lag], shift: Mapping[str, float], units: Sequence[str]) -> Iterator[str]:
    """Yield a line for each channel that comes too early or too late, after the `shift` in s that it has been given.

    Not for those whose sign or unit is told to be wrong: these look late then.
    """
    for key, (ahead, behind, least) in LIMITS.items():
        lag, name = lags.get(key), key.split(" ")[0]
        if any(re.search(rf"\b{name}\b", line) or "heading" in line for line in units):
            continue
        if lag is None or lag.best < least or lag.best - lag.unshifted < (1e-3 if "curvature" in key else GAIN):
            continue
        answer = "the yaw rate" if name in ("delta", "delta_ref") else "the acceleration"
        cure = f"data.shift.{name}={round(shift.get(name, 0.0) + lag.seconds, 6):g} lines them up"
        told = f"{abs(lag.seconds):.3f} s"
        if abs(lag.seconds) > 0.96 * MAX_LAG:  # the best of all shifts tried is the last
            told, cure = f"{MAX_LAG:g} s or more", f"look for the shift with {cure.split(' ')[0]} and on from there"
        if lag.seconds >= ahead:
            yield f"{name} is {told} ahead of {answer}: a lag of the car or stamps of another clock; {cure}"
        elif lag.seconds <= -behind:
            yield f"{name} is {told} behind {answer}, which no car does: stamps of another clock; {cure}"
    lag = lags.get("delta_ref to delta")
    if lag is not None and lag.best > 0.5 and lag.best - lag.unshifted > 1e-3 and not -0.015 <= lag.seconds <= 0.15:
        yield f"delta follows delta_ref by {lag.seconds:+.3f} s; expected is 0 … 0.15 s; check the stamps of both"


# ---- traps in single channels


def _constant(log: Log) -> Iterator[str]:
    for name in log.channels:
        values = log.array(name)
        if np.ptp(values) <= 1e-12 * max(1.0, float(np.abs(values).max())):
            told = f"{name} is constant ({values[0]:.4g} {CHANNELS[name].unit})"
            commanded = name.endswith("_ref")
            yield f"{told}: it does not show how fast the car answers" if commanded else f"{told}: a dead sensor?"


def _slow(log: Log) -> Iterator[tuple[str, float]]:
    """Yield the measured channels that mostly repeat themselves, and their updates per second; commands may."""
    moving = np.abs(log.array("v_x")) > 0.2 if "v_x" in log.table else np.ones(len(log.table), dtype=bool)
    both = (np.diff(log.table["run"].to_numpy()) == 0) & moving[1:] & moving[:-1]
    if both.sum() < ENOUGH:
        return
    for name in log.channels:
        changed = np.diff(log.array(name))[both] != 0.0
        if not name.endswith("_ref") and 1.0 - changed.mean() >= HELD_SHARE and changed.sum() >= 5:
            yield name, float(changed.mean() / log.dt)


def _held(log: Log) -> Iterator[str]:
    for name, rate in _slow(log):
        yield (
            f"{name} is held between updates: {rate:.1f} of {1 / log.dt:.0f} samples per second are new, "
            f"so it is {0.5 / rate:.3f} s old on average"
        )


def _clipped(log: Log) -> Iterator[str]:
    held = {name for name, _ in _slow(log)}
    for name in ("v_x", "v_y", "yaw_rate", "omega", "current"):
        if name not in log.table or name in held or len(log.table) < ENOUGH:
            continue
        values = log.array(name)
        for bound, side in ((values.max(), "largest"), (values.min(), "smallest")):
            share = float(np.mean(values == bound))
            if share >= CLIPPED_SHARE and bound != 0.0 and np.ptp(values) > 0:
                yield f"{name} is clipped: {share:.1%} of its samples are exactly its {side} value {bound:.4g}"


# ---- signs and units


def _heading(log: Log) -> Iterator[str]:
    """Yield what is wrong with a pose that does not move the way it points; a car slips to both sides alike."""
    if not _has(log, *POSE):
        return
    span = max(1, round(0.1 / log.dt))
    ways, yaws, wheels = [], [], []
    for run in log.runs():
        x, y, yaw = (run[name].to_numpy() for name in POSE)
        dx, dy = (each[2 * span :] - each[: -2 * span] for each in (x, y))
        fast = np.hypot(dx, dy) > MOVING * 2 * span * log.dt
        ways.append(np.arctan2(dy, dx)[fast])
        yaws.append(yaw[span:-span][fast])
        wheels.append(run["omega"].to_numpy()[span:-span][fast] if "omega" in run else np.zeros(int(fast.sum())))
    way, yaw, wheel = (np.concatenate(each) if each else np.zeros(0) for each in (ways, yaws, wheels))
    if len(way) < ENOUGH:
        return
    kept, off = _alike(way, yaw)
    ahead = np.sign(wheel) if np.any(wheel) else np.ones(len(way))
    if np.mean(np.cos(way - yaw - off) * ahead) < 0.0 < UNLIKE <= kept and abs(off) > TURNED:
        off -= math.copysign(math.pi, off)
    others = {said: _alike(way, other) for said, other in _other_headings(yaw).items()}
    best = max(others, key=lambda said: (round(others[said][0], 1), -abs(others[said][1])))
    if kept < UNLIKE and others[best][0] > LIKE:
        yield f"the heading does not follow the way that the pose moves: {best}"
    elif kept >= UNLIKE and abs(off) > TURNED:
        turned = f"{math.degrees(off):+.0f}° off the way that the pose moves"
        yield f"the heading is {turned}: add {off:.4g} to data.frame.yaw"
    elif np.mean(np.cos(way - yaw) * np.sign(wheel)) < -0.5:
        yield "the heading points backwards while omega is forwards: add 3.1416 to data.frame.yaw, or turn omega's sign"


def _other_headings(yaw: Array) -> dict[str, Array]:
    """Return what a heading may be that is none of ours, and what it would be then in rad."""
    return {
        "yaw in deg? scale: 0.0174533": np.radians(yaw),
        "turned the other way round, or y (or x) has the other sign?": -yaw,
        "x and y exchanged, or a compass's heading, clockwise from y?": math.pi / 2 - yaw,
    }


def _alike(way: Array, yaw: Array) -> tuple[float, float]:
    """Return how alike directions and headings are, 0 … 1, and how far apart in rad, forwards or backwards."""
    mean = np.exp(2j * (way - yaw)).mean()
    return float(abs(mean)), float(np.angle(mean)) / 2.0


def _signs_and_units(log: Log, wheelbase: float) -> Iterator[str]:
    moving = _moving(log)
    for name in ("delta", "delta_ref"):
        if _has(log, "v_x", "yaw_rate", name) and moving.sum() >= ENOUGH:
            angle, r = log.array(name)[moving], log.array("yaw_rate")[moving]
            kinematic = log.array("v_x")[moving] * np.tan(angle) / wheelbase
            if kinematic.std() < 0.02 or r.std() < 0.02:
                continue
            correlation = float(np.corrcoef(kinematic, r)[0, 1])
            if correlation < -0.4:
                yield f"{name} and yaw_rate have opposite signs (correlation {correlation:.2f}); left is positive"
            speed = log.array("v_x")[moving]
            gentle = np.abs(speed * r) < 3.0  # m/s², below which tyres hardly slip
            # a countersteered drift is not gentle; when the angle's unit is wrong, the limit falls on everything alike
            straight = np.abs(speed * kinematic) < max(3.0, float(np.percentile(np.abs(speed * kinematic), 30)))
            gentle &= straight
            size = float(np.sum(kinematic[gentle] * r[gentle]) / max(np.sum(kinematic[gentle] ** 2), 1e-12))
            if correlation > 0.4 and gentle.sum() >= ENOUGH and not 0.25 < size < 2.5:
                yield (
                    f"yaw_rate is {size:.3g} times v_x tan({name})/wheelbase in gentle curves: "
                    f"{_factor(size, 'yaw_rate', name, ANGLES)} "
                    f"Check the units and data.vehicle.wheelbase = {wheelbase:g} m"
                )
    if "v_x" in log.table and moving.sum() < ENOUGH:
        yield f"it hardly drives forwards faster than {MOVING:g} m/s: signs, units and lags are not checked"
    yield from _other_axes(log)
    yield from _wheel_unit(log, moving)


def _other_axes(log: Log) -> Iterator[str]:
    """Yield that the car does not drive where its wheels roll: its velocities are then along other axes."""
    if not _has(log, "v_x", "omega"):
        return
    rolling = np.abs(log.array("omega")) > MOVING
    wheel, speed = log.array("omega")[rolling], log.array("v_x")[rolling]
    if len(wheel) < ENOUGH or min(np.std(np.abs(wheel)), np.std(speed)) < 0.2:
        return
    follows = float(np.corrcoef(wheel, speed)[0, 1])
    if abs(follows) < FOLLOWS:
        yield f"v_x does not follow omega (correlation {follows:.2f}): are the velocities along the world's axes?"


def _wheel_unit(log: Log, moving: NDArray[np.bool_]) -> Iterator[str]:
    for name in ("omega", "omega_ref"):
        if not _has(log, "v_x", name) or moving.sum() < ENOUGH:
            continue
        straight = moving
        if "yaw_rate" in log.table:
            straight = moving & (np.abs(log.array("yaw_rate")) < 0.5)
            straight = straight if straight.sum() >= ENOUGH / 3 else moving
        wheel, speed = log.array(name)[straight], log.array("v_x")[straight]
        ratio = float(np.median(wheel / speed))
        if ratio < -0.2:
            yield f"{name} has the opposite sign of v_x (ratio {ratio:.2f}); turn the sign of its scale"
        elif not RATIOS[name][0] < ratio < RATIOS[name][1]:
            # another unit is the same at every speed, a limit is not; one command alone cannot tell them apart
            unit = _factor(ratio, name, "v_x", SPEEDS)
            limited = name == "omega_ref" and ratio > 1.0 and np.percentile(wheel, 95) < 1.1 * np.percentile(wheel, 5)
            cause = f"the car is limited, or {unit}" if limited else unit
            yield f"{name} is {ratio:.3g} times v_x on straights: {cause} Its unit must be m/s at the tyre"


def _factor(ratio: float, one: str, other: str, units: Mapping[str, float]) -> str:
    """Return what a factor of one channel over another may come from."""
    for unit, factor in units.items():
        for name, expected in ((one, factor), (other, 1 / factor)):
            if ratio and abs(math.log(abs(ratio) / expected)) < 0.15:
                return f"{name} in {unit}?"
    return "rad/s of a small wheel?" if 8.0 < ratio < 50.0 else "rpm?" if ratio >= 50.0 else "another unit or scale?"


def _contradictions(compared: Comparison) -> Iterator[str]:
    """Velocities that were not made from the poses must agree with them; where yaw is in deg, none can."""
    found = [(*each, _unit_beside_pose(each[0], each[2])) for each in differences(compared)]
    degrees = [row for row in found if row[3] == "yaw in deg?"]
    for name, correlation, factor, cause in degrees or found:
        if correlation < -0.5:
            yield f"{name} has the opposite sign of the differentiated pose (correlation {correlation:.2f})"
        elif correlation > 0.7 and not 0.6 < factor < 1.6:
            yield f"{name} is {factor:.3g} times the differentiated pose: {cause}"
        elif correlation < 0.5:
            yield f"{name} does not follow the differentiated pose (correlation {correlation:.2f}); axes turned?"


def _unit_beside_pose(name: str, factor: float) -> str:
    """Return what a velocity's factor over the differentiated pose may come from."""
    pose, units = ("yaw", ANGLES) if name == "yaw_rate" else ("x and y", SPEEDS)
    return _factor(factor, name, pose, units)


def _apart(compared: Comparison) -> Iterator[str]:
    """Yield how velocities are of another point or another time than the poses beside them."""
    if compared.offset:
        place = f"{abs(compared.offset):.2f} m {'ahead of' if compared.offset > 0 else 'behind'}"
        yield f"v_y belongs to a point {place} the one x and y track; data.velocities=poses makes it from the poses"
    if compared.late:
        yield (
            f"yaw_rate lags the differentiated yaw by {compared.late:.3f} s: filtered, or stamps of another clock; "
            "data.velocities=poses makes velocities from the poses"
        )


# ---- doubled driving


def _stretches(log: Log) -> NDArray[np.uint64]:
    """Return a hash of each ALIKE rows in a row: single rows of rounded numbers are alike by chance."""
    rows, mixed = _row_hashes(log), np.zeros(0, dtype=np.uint64)
    if len(rows) >= ALIKE:
        mixed = np.zeros(len(rows) - ALIKE + 1, dtype=np.uint64)
        for place in range(ALIKE):
            mixed = mixed * MIX + rows[place : place + len(mixed)]  # modulo 2⁶⁴
    return mixed


def _seconds(alike: NDArray[np.bool_], log: Log) -> float:
    """Return the seconds of the rows that lie in such stretches, of which `alike` marks the first rows."""
    return float(np.count_nonzero(np.convolve(alike, np.ones(ALIKE)) > 0.5) * log.dt) if alike.any() else 0.0


def _row_hashes(log: Log) -> NDArray[np.uint64]:
    """Return a hash per moving row of all channels; rows that repeat the one before are left out."""
    table = log.table[log.channels]
    fresh = np.concatenate([[True], (np.diff(table.to_numpy(), axis=0) != 0.0).any(axis=1)])
    if "v_x" in table:
        fresh &= np.abs(log.array("v_x")) > MOVING / 2
    return np.asarray(pd.util.hash_pandas_object(table[fresh], index=False), dtype=np.uint64)


def _doubled(log: Log) -> Iterator[str]:
    repeated = _seconds(pd.Series(_stretches(log)).duplicated().to_numpy(), log)
    if repeated >= REPEATED:
        yield f"{repeated:.1f} s of driving are in the log twice, row for row; drop the doubled runs"
