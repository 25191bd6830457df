"""What the data say about each parameter: intervals by block bootstrap, and what can't be told apart.

Each block (a run, or a stretch of one when runs are few) contributes its own gradient and curvature at the optimum; a
resample of the blocks moves the optimum by one Gauss–Newton step. Separability is judged from the data alone, without
the priors: by the width of the interval and by the correlations of the estimates.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from racerl.identify.methods import Fit
from racerl.identify.objective import Objective

Array = NDArray[np.float64]

RESAMPLES = 1000
FEWEST_BLOCKS = 20
CORRELATION = 0.95  # above which two parameters are named as not separable
IDENTIFIED = 0.05  # largest half-width of the 95 % interval, relative to the value, of an identified parameter


@dataclass(frozen=True)
class Uncertainty:
    """Bootstrap draws (K, P), the data's own 95 % half-widths (P,) and correlations (P, P)."""

    draws: Array
    half_width: Array
    correlation: Array


def estimate(fit: Fit, objective: Objective, runs: NDArray[np.int64], independent: float, seed: int) -> Uncertainty:
    """Return the uncertainty of a fit; `runs` (W,) says which run each window lies in."""
    unknowns, at = objective.unknowns, fit.linearised
    H, g = at.reduced()
    scale = unknowns.sigma
    H, g = H * np.outer(scale, scale), g * scale
    distance = (fit.point.theta - unknowns.start) / scale
    bound = (fit.point.theta <= unknowns.low) | (fit.point.theta >= unknowns.high)

    information = H.sum(axis=0)
    covariance = at.data / independent * _inverse(information)
    deviation = np.sqrt(np.maximum(np.diag(covariance), 1e-300))

    blocks = _blocks(runs)
    H_b, g_b = _sum_by(H, blocks), _sum_by(g, blocks)
    generator = np.random.default_rng(seed)
    draws = np.empty((RESAMPLES, len(scale)))
    free = ~bound
    for i in range(RESAMPLES):
        count = np.bincount(generator.integers(len(H_b), size=len(H_b)), minlength=len(H_b))
        A = np.tensordot(count, H_b, 1) + objective.penalty * np.eye(len(scale))
        b = count @ g_b + objective.penalty * distance
        step = np.zeros(len(scale))
        step[free] = -_inverse(A[np.ix_(free, free)]) @ b[free]
        draws[i] = unknowns.clip(fit.point.theta + step * scale)
    return Uncertainty(
        draws,
        1.96 * deviation * scale,
        covariance / np.outer(deviation, deviation),
    )


def _inverse(matrix: Array) -> Array:
    """Return the inverse of a symmetric positive matrix of any scaling; what it does not determine comes out large."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    inverse = np.linalg.inv(matrix * np.outer(scale, scale) + 1e-13 * np.eye(len(matrix)))
    rescaled: Array = inverse * np.outer(scale, scale)
    return rescaled


def _blocks(runs: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return a block number per window: its run, or a stretch of the whole when there are too few runs."""
    _, block = np.unique(runs, return_inverse=True)
    if block.max() + 1 >= FEWEST_BLOCKS:
        return block
    return np.arange(len(runs)) * min(FEWEST_BLOCKS, len(runs)) // len(runs)


def _sum_by(values: Array, block: NDArray[np.int64]) -> Array:
    total = np.zeros((block.max() + 1, *values.shape[1:]))
    np.add.at(total, block, values)
    return total


def describe(fit: Fit, objective: Objective, uncertainty: Uncertainty) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Return {name: facts} of every free parameter, and the pairs that are not separable."""
    unknowns = objective.unknowns
    pairs = _inseparable(unknowns.names, uncertainty.correlation)
    interval = np.percentile(uncertainty.draws, [2.5, 97.5], axis=0).T
    table = {}
    for i, name in enumerate(unknowns.names):
        value = float(fit.point.theta[i])
        half_width = float(uncertainty.half_width[i])
        with_others = [p["parameters"][1 - p["parameters"].index(name)] for p in pairs if name in p["parameters"]]
        bound = "low" if value <= unknowns.low[i] else "high" if value >= unknowns.high[i] else None
        identified = bound is None and half_width <= IDENTIFIED * abs(value)
        table[name] = {
            "value": value,
            "unit": unknowns.specifications[i].unit,
            "ci95": [float(end) for end in interval[i]],
            "start": float(unknowns.start[i]),
            "prior_sigma": float(unknowns.sigma[i]),
            "bounds": [float(unknowns.low[i]), float(unknowns.high[i])],
            "at_bound": bound,
            "data_half_width": half_width,
            "identified": bool(identified),
            "not_separable_from": with_others,
            "from_prior": float((value - unknowns.start[i]) / unknowns.sigma[i]),
        }
    return table, pairs


def _inseparable(names: tuple[str, ...], correlation: Array) -> list[dict[str, Any]]:
    return [
        {"parameters": [names[i], names[j]], "correlation": float(correlation[i, j])}
        for i in range(len(names))
        for j in range(i)
        if abs(correlation[i, j]) > CORRELATION
    ]
