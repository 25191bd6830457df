"""How fast errors grow: windows cut into segments, short enough to say where and when.

An error's growth over a segment, d = ē_end − ē_begin with ē a mean of three samples, is local, while the error itself
carries along what happened before. Under noise alone d² is 2σ²/3.
"""

import numpy as np
from numpy.typing import NDArray

from racerl.gap.evidence import Evidence

Array = NDArray[np.float64]
SEGMENT = 17  # samples
APART = 3.0  # radii between places


def _begins(length: int) -> NDArray[np.int64]:
    return np.arange(0, length - SEGMENT, SEGMENT)


def growth(errors: Array, noise: Array) -> Array:
    """Return d² over what noise alone makes of it, (W·K, C), of errors (T + 1, C, W) and noise (C,)."""
    begins = _begins(len(errors))
    mean = (errors[:-2] + errors[1:-1] + errors[2:]) / 3.0
    d = mean[np.minimum(begins + SEGMENT, len(mean) - 1)] - mean[begins]  # (K, C, W)
    power: Array = d.transpose(2, 0, 1).reshape(-1, errors.shape[1]) ** 2 / (2.0 / 3.0 * noise**2)
    return power


def segments(evidence: Evidence, values: Array) -> Array:
    """Return the mean over every segment (W·K,) of what is known at every row (R,)."""
    begins = _begins(evidence.length + 1)
    rows = evidence.start[:, None, None] + begins[None, :, None] + np.arange(SEGMENT)
    return values[rows].mean(axis=2).ravel()


def places(evidence: Evidence, errors: Array, noise: Array, radius: float, count: int) -> list[tuple[float, float]]:
    """Return where in the world errors grow most: middles of circles, apart from each other, most excess first."""
    power = growth(errors, noise).mean(axis=1)
    power = np.minimum(power, np.quantile(power, 0.99))
    x, y = (segments(evidence, evidence.columns[axis]) for axis in ("x", "y"))
    above = power - np.median(power)

    def near(i: int) -> NDArray[np.bool_]:
        return np.asarray((x - x[i]) ** 2 + (y - y[i]) ** 2 < radius**2)

    def excess(inside: NDArray[np.bool_]) -> float:
        return float(above[inside].sum() / np.sqrt(inside.sum()))

    sums = np.array([excess(near(i)) for i in range(len(x))])
    found: list[tuple[float, float]] = []
    for i in np.argsort(-sums):
        if sums[i] <= 0.0 or len(found) == count:
            break
        inside = near(i) & (above > 0.0)
        place = float(np.average(x[inside], weights=power[inside])), float(np.average(y[inside], weights=power[inside]))
        if all(np.hypot(place[0] - a, place[1] - b) > APART * radius for a, b in found):
            found.append(place)
    return found
