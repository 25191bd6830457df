"""The proof: how far the gap shrinks on windows that no fit has seen, per channel and horizon."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from racerl.estimation.blocks import resampled
from racerl.gap.candidates import unfitted
from racerl.gap.comparison import WORSE, wild
from racerl.gap.cross_validation import held_out_errors
from racerl.gap.evidence import Evidence
from racerl.gap.fitted_model import FittedModel
from racerl.gap.folds import blocks
from racerl.gap.investigation import Investigation
from racerl.gap.locate import HORIZONS, maps, sound

Array = NDArray[np.float64]
RESAMPLES = 2000
STRETCH = 4  # windows side by side that are shown of the worst stretch
STEP = 17  # samples between the points of a window's path


def prove(investigation: Investigation, found: FittedModel) -> dict[str, Any]:
    """Return the gap before and after; `before` is the refitted vehicle without the effects found.

    A window that a vehicle misses by far, such as a spin that it foretells the other way round, counts up to a limit;
    one that is missed so without the effects and with them is left out.
    """
    base = held_out_errors(investigation, investigation.base)
    after = {**base, **held_out_errors(investigation, found)}
    told = (unfitted(investigation).errors(), base, after, investigation.noise_errors)
    limited, within = zip(*(_limited(investigation, errors) for errors in told), strict=True)
    powers = [_power(investigation, errors) for errors in limited]
    tame = {stage: _tame(within[1][stage], within[2][stage]) for stage in base}
    gap = _gap(*(np.concatenate([part[stage][tame[stage]] for stage in base]) for part in powers))
    gap["ci95"] = _interval(investigation, *powers[1:], tame=tame)
    calm = [{stage: errors[stage][:, :, tame[stage]] for stage in base} for errors in limited]
    gap["by_channel"] = _by_channel(investigation, *calm[1:])
    return {
        "gap": gap,
        "wild_windows": {stage: int((~mask).sum()) for stage, mask in tame.items()},
        "by_horizon": _by_horizon(investigation, calm[1], calm[2], tame),
        "worse": [name for name, row in gap["by_channel"].items() if row["after"] > WORSE * row["before"]],
        "maps": {"before": maps(investigation, base), "after": maps(investigation, after)},
        "stretch": _stretch(investigation, base, after, tame, powers[1], powers[3]),
        "path": _path(investigation, *(power["chassis"] for power in powers[1:])) if "chassis" in base else [],
    }


def _stretch(
    investigation: Investigation,
    before: Mapping[str, Array],
    after: Mapping[str, Array],
    tame: Mapping[str, NDArray[np.bool_]],
    power: Mapping[str, Array],
    floor: Mapping[str, Array],
) -> dict[str, Any]:
    """Return the windows side by side that the refitted vehicle misses most, in the stage with the largest gap.

    Every window has `t` (T + 1) in s, and `measured`, `before`, `after` (C, T + 1).
    """
    stage = max(power, key=lambda name: power[name][tame[name]].sum() / floor[name][tame[name]].sum())
    evidence, shows = investigation.evidence[stage], sound(before[stage]) & sound(after[stage])
    own = np.where(tame[stage] & shows, power[stage], 0.0)
    first = _worst(evidence, own)
    beside = range(first, min(first + STRETCH, len(own)))
    shown = [w for w in beside if evidence.run[w] == evidence.run[first] and shows[w]]
    rows = evidence.start[shown][:, None] + np.arange(evidence.length + 1)
    time = evidence.columns["t"]
    measured = np.stack([evidence.columns[name][rows] for name in evidence.observed], axis=1)  # (N, C, T + 1)
    return {
        "stage": stage,
        "channels": list(evidence.observed),
        "noise": [float(value) for value in investigation.noise[stage]],
        "windows": [
            {
                "t": (time[rows[i]] - time[evidence.first[rows[i, 0]]]).tolist(),
                "measured": measured[i].tolist(),
                "before": (measured[i] + before[stage][:, :, w].T).tolist(),
                "after": (measured[i] + after[stage][:, :, w].T).tolist(),
            }
            for i, w in enumerate(shown)
        ],
    }


def _worst(evidence: Evidence, power: Array) -> int:
    """Return the first of the windows side by side in a run that have the largest power together."""
    sums = np.zeros(len(power))
    for run in np.unique(evidence.run):
        mine = np.flatnonzero(evidence.run == run)
        size = min(STRETCH, len(mine))
        sums[mine[: len(mine) - size + 1]] = np.convolve(power[mine], np.ones(size), mode="valid")
    return int(sums.argmax())


def _path(investigation: Investigation, before: Array, after: Array, floor: Array) -> list[dict[str, Any]]:
    """Return where every window was driven, and its error over the noise's; nothing without poses."""
    evidence = investigation.evidence["chassis"]
    if not {"x", "y"} <= set(evidence.columns):
        return []
    rows = evidence.start[:, None] + np.append(np.arange(0, evidence.length, STEP), evidence.length)
    unit = float(floor.mean())
    return [
        {
            "x": evidence.columns["x"][rows[w]].round(3).tolist(),
            "y": evidence.columns["y"][rows[w]].round(3).tolist(),
            "before": float(np.sqrt(before[w] / unit)),
            "after": float(np.sqrt(after[w] / unit)),
        }
        for w in range(len(rows))
    ]


def _limited(
    investigation: Investigation, errors: Mapping[str, Array]
) -> tuple[dict[str, Array], dict[str, NDArray[np.bool_]]]:
    """Return errors of which those of no window count beyond a limit, and which windows (W,) are within it.

    A window in which the rollout blew up counts as one at the limit.
    """
    found, within = {}, {}
    for stage, part in errors.items():
        whole = sound(part)
        power = _power(investigation, {stage: np.where(whole, part, 0.0)})[stage]
        limit = wild(investigation, stage, power)
        even = investigation.noise[stage][:, None] * np.sqrt(limit / investigation.evidence[stage].numbers)
        found[stage] = np.where(whole, part, even) * np.sqrt(limit / np.maximum(power, limit))
        within[stage] = whole & (power <= limit)
    return found, within


def _tame(before: NDArray[np.bool_], after: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the windows (W,) that are within the limit without the effects or with them."""
    tame = before | after
    return tame if tame.any() else np.ones_like(tame)


def _power(investigation: Investigation, errors: Mapping[str, Array]) -> dict[str, Array]:
    """Return the summed squared errors over the noise, per window and stage."""
    return {name: ((part / investigation.noise[name][:, None]) ** 2).sum(axis=(0, 1)) for name, part in errors.items()}


def _gap(unfitted: Array, before: Array, after: Array, floor: Array) -> dict[str, Any]:
    """Return root-mean-square errors in units of what noise alone leaves."""
    unit = floor.sum()
    return {
        "unfitted": float(np.sqrt(unfitted.sum() / unit)),
        "before": float(np.sqrt(before.sum() / unit)),
        "after": float(np.sqrt(after.sum() / unit)),
        "noise_floor": 1.0,
        "explained": explained(before.sum(), after.sum(), unit),
    }


def explained(before: float, after: float, floor: float) -> float:
    """Return (before² − after²)/(before² − floor²) from squares, inside [0, 1]."""
    return float(np.clip((before - after) / max(before - floor, 1e-12), 0.0, 1.0)) if before > floor else 0.0


def _interval(
    investigation: Investigation,
    before: Mapping[str, Array],
    after: Mapping[str, Array],
    floor: Mapping[str, Array],
    *,
    tame: Mapping[str, NDArray[np.bool_]],
) -> list[float]:
    """Return the 95 % interval of what is explained, over blocks of windows."""
    generator = np.random.default_rng(investigation.seed)
    number = np.concatenate(list(blocks({name: investigation.evidence[name] for name in before}).values()))
    sums = [
        np.bincount(number, np.concatenate([part[name] * tame[name] for name in before]))
        for part in (before, after, floor)
    ]
    b, a, f = resampled(np.stack(sums, axis=1), RESAMPLES, generator).T
    shares = np.clip((b - a) / np.maximum(b - f, 1e-12), 0.0, 1.0)
    return [float(value) for value in np.quantile(shares, [0.025, 0.975])]


def _by_channel(
    investigation: Investigation,
    before: Mapping[str, Array],
    after: Mapping[str, Array],
    floor: Mapping[str, Array],
) -> dict[str, dict[str, float]]:
    return {
        channel: {
            "before": _rms(before[name][:, c]),
            "after": _rms(after[name][:, c]),
            "floor": _rms(floor[name][:, c]),
        }
        for name, evidence in investigation.evidence.items()
        for c, channel in enumerate(evidence.observed)
    }


def _by_horizon(
    investigation: Investigation,
    before: Mapping[str, Array],
    after: Mapping[str, Array],
    tame: Mapping[str, NDArray[np.bool_]],
) -> list[dict[str, Any]]:
    """Return errors by channel and horizon, with the 95 % interval of their ratio after/before."""
    generator = np.random.default_rng(investigation.seed)
    rows = []
    for name, evidence in investigation.evidence.items():
        block = np.unique(blocks({name: evidence})[name][tame[name]], return_inverse=True)[1]
        for c, channel in enumerate(evidence.observed):
            for h in (h for h in HORIZONS if h < len(before[name])):
                sums = [np.bincount(block, part[name][h, c] ** 2).astype(float) for part in (before, after)]
                old, new = resampled(np.stack(sums, axis=1), RESAMPLES, generator).T
                ratio = np.sqrt(new / np.maximum(old, 1e-300))
                rows.append(
                    {
                        "stage": name,
                        "channel": channel,
                        "horizon": h,
                        "before": _rms(before[name][h, c]),
                        "after": _rms(after[name][h, c]),
                        "ratio_ci95": [float(value) for value in np.quantile(ratio, [0.025, 0.975])],
                    }
                )
    return rows


def _rms(errors: Array) -> float:
    return float(np.sqrt((errors**2).mean()))
