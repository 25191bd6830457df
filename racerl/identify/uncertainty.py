"""What the data say about each parameter: intervals by block bootstrap, and what can't be told apart.

Each block (a run, or a stretch of one when runs are few) contributes its own gradient and curvature at the optimum; a
resample of the blocks, and of the priors' means, moves the optimum by one Gauss–Newton step. A prior's mean is as
unsure as its deviation says, or as far as the fit has gone from it: a car whose tyre is five deviations stiffer than
expected was expected wrongly, and is still drawn back by a little. With fewer than a handful of blocks the curvature
alone sets the width of the data's share. Separability is judged from the data without the priors: by the width of the
interval and by the correlations of the estimates.

What was settled by an earlier fit, to channels of its own, moves by that fit's draws, and the others follow it:

    Δθ = Δθ|settled + G Δsettled,   G = −H⁻¹ H_settled.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from racerl.estimation.blocks import counts, stretches
from racerl.estimation.unknowns import Unknowns, unsure
from racerl.identify.methods import Fit
from racerl.identify.objective import Objective
from racerl.identify.windows import Cut

Array = NDArray[np.float64]

RESAMPLES = 1000
ENOUGH_RUNS = 20  # to resample whole runs
FEWEST_BLOCKS = 8  # to resample anything
CORRELATION = 0.95  # above which two parameters are named as not separable
IDENTIFIED = 0.05  # largest half-width of the 95 % interval, relative to the value, of an identified parameter


@dataclass(frozen=True)
class Uncertainty:
    """Names of parameters, bootstrap draws of them (K, P), and the covariance (P, P) that the data alone leave."""

    names: tuple[str, ...]
    draws: Array
    covariance: Array

    @property
    def deviation(self) -> Array:
        """Standard deviations from the data alone, (P,)."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 1e-300))

    @property
    def half_width(self) -> Array:
        """95 % half-widths from the data alone, (P,)."""
        return 1.96 * self.deviation

    @property
    def correlation(self) -> Array:
        """Correlations from the data alone, (P, P)."""
        return self.covariance / np.outer(self.deviation, self.deviation)


def estimate(
    fit: Fit, objective: Objective, cut: Cut, independent: float, seed: int, earlier: Sequence[Uncertainty] = ()
) -> Uncertainty:
    """Return the uncertainty of a fit to the windows of a cut, which are worth so many independent residuals.

    Parameters that `earlier` names were settled by other fits and held in this one.
    """
    unknowns, at = objective.unknowns, fit.linearised
    scale, theta = unknowns.sigma, fit.point.theta
    H, g = at.reduced()
    H, g = H * np.outer(scale, scale), g * scale
    settled = np.array([unknowns.names.index(name) for part in earlier for name in part.names], dtype=np.intp)
    free = np.setdiff1d(np.arange(len(scale)), settled)
    H_free, H_settled = (H.sum(axis=0)[np.ix_(free, other)] for other in (free, settled))
    with_prior = _inverse(H_free + objective.penalty * np.eye(len(free)))
    noise = at.data / independent

    generator = np.random.default_rng(seed)
    block = _blocks(cut)
    H_b, g_b = _sum_by(H[:, free][:, :, free], block), _sum_by(g[:, free], block)
    distance = ((theta - unknowns.start) / scale)[free]
    own = (
        _resample(H_b, g_b, objective.penalty, distance, generator)
        if len(H_b) >= FEWEST_BLOCKS
        else normal(noise * with_prior, generator)
    )
    own -= objective.penalty * _surprise(distance, generator) @ with_prior
    moves, covariance = _settled(earlier, theta[settled])
    moves, covariance = moves / scale[settled], covariance / np.outer(scale[settled], scale[settled])
    order = np.argsort([*free, *settled])
    steps = np.hstack([own - moves @ H_settled.T @ with_prior, moves])[:, order]
    draws = theta + steps * scale
    draws[:, free] = unknowns.clip(draws)[:, free]
    gain = -_inverse(H_free) @ H_settled
    follow = gain @ covariance
    joint = np.block([[noise * _inverse(H_free) + follow @ gain.T, follow], [follow.T, covariance]])
    return Uncertainty(unknowns.names, draws, joint[np.ix_(order, order)] * np.outer(scale, scale))


def _settled(earlier: Sequence[Uncertainty], theta: Array) -> tuple[Array, Array]:
    """Return how far the draws of earlier fits are from their values (K, Q), and their covariance (Q, Q)."""
    if not earlier:
        return np.empty((RESAMPLES, 0)), np.empty((0, 0))
    draws = np.concatenate([part.draws for part in earlier], axis=1)
    return draws - theta, block_diag(*(part.covariance for part in earlier))


def _resample(H: Array, g: Array, penalty: float, distance: Array, generator: np.random.Generator) -> Array:
    """Return the optimum's moves (K, P) over resampled blocks and priors' means; `distance` (P,) is (θ − θ_0)/σ."""
    steps = np.empty((RESAMPLES, len(distance)))
    for i, count in enumerate(counts(len(H), RESAMPLES, generator)):
        A = np.tensordot(count, H, 1) + penalty * np.eye(len(distance))
        b = count @ g + penalty * (distance + generator.standard_normal(len(distance)))
        steps[i] = -_inverse(A) @ b
    return steps


def _surprise(distance: Array, generator: np.random.Generator) -> Array:
    """Return how much further the priors' means may be off than their deviations say, in deviations (K, P)."""
    return generator.standard_normal((RESAMPLES, len(distance))) * np.sqrt(unsure(distance) ** 2 - 1.0)


def normal(covariance: Array, generator: np.random.Generator) -> Array:
    """Return draws (RESAMPLES, P) from N(0, covariance)."""
    values, vectors = np.linalg.eigh(covariance)
    return generator.standard_normal((RESAMPLES, len(values))) * np.sqrt(np.maximum(values, 0.0)) @ vectors.T


def _inverse(matrix: Array) -> Array:
    """Return the inverse of a symmetric positive matrix of any scaling; what it does not determine comes out large."""
    diagonal = np.diag(matrix)
    scale = 1.0 / np.sqrt(np.maximum(diagonal, max(1e-20 * diagonal.max(initial=0.0), 1e-30)))
    inverse = np.linalg.inv(matrix * np.outer(scale, scale) + 1e-13 * np.eye(len(matrix)))
    rescaled: Array = inverse * np.outer(scale, scale)
    return rescaled


def _blocks(cut: Cut) -> NDArray[np.int64]:
    """Return a block number per window: its run, or stretches of it, longer than a window, when runs are few."""
    runs, run = np.unique(cut.run, return_inverse=True)
    if len(runs) >= ENOUGH_RUNS:
        return run
    length = len(cut.windows.inputs) + 1
    longest = max(2 * length, int(cut.start.max()) // ENOUGH_RUNS + 1)
    return stretches(run, cut.start, longest)


def _sum_by(values: Array, block: NDArray[np.int64]) -> Array:
    total = np.zeros((block.max() + 1, *values.shape[1:]))
    np.add.at(total, block, values)
    return total


def describe(unknowns: Unknowns, theta: Array, uncertainty: Uncertainty) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Return {name: facts} of every free parameter, and the pairs that are not separable."""
    pairs = _inseparable(unknowns.names, uncertainty.correlation)
    interval = np.percentile(uncertainty.draws, [2.5, 97.5], axis=0).T
    table = {}
    for i, name in enumerate(unknowns.names):
        value = float(theta[i])
        half_width = float(uncertainty.half_width[i])
        with_others = [p["parameters"][1 - p["parameters"].index(name)] for p in pairs if name in p["parameters"]]
        bound = "low" if value <= unknowns.low[i] else "high" if value >= unknowns.high[i] else None
        spread = max(half_width, float(interval[i, 1] - interval[i, 0]) / 2)
        identified = bound is None and spread <= IDENTIFIED * abs(value)
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
