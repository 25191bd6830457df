"""The noise of a channel: what is too fast for a car.

Filters take away what is fast, and noise shows there alone. So samples are thinned until what is fast in them is white;
where it never is, for the motion is as fast, the noise may be larger than what is told.
"""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_coeffs, savgol_filter
from scipy.special import comb

Array = NDArray[np.float64]
LOCAL, ORDER = 11, 4  # samples and order of the local polynomials that tell noise from motion
TOP = 6  # order of the differences that show noise near the Nyquist frequency
THINNED = 5  # one sample of so many is taken at least, where a filter has made neighbours alike
NEARLY = 0.7  # share of what is white from which on no more samples are left out


def channel_noise(runs: Sequence[Array]) -> float:
    """Return the standard deviation of the noise in the runs of a channel, each (rows,); 0 if none is beyond LOCAL."""
    found: list[float] = []
    for step in range(1, THINNED + 1):
        parts = [run[begin::step] for run in runs for begin in range(step)]
        found.append(_pooled(parts, spread))
        if _pooled(parts, _fast) > NEARLY * found[-1]:
            return found[-1]
    return found[0]


def spread(column: Array) -> float:
    """Return the standard deviation of what local polynomials do not follow in one run's channel (rows,)."""
    centre = savgol_coeffs(LOCAL, ORDER)[LOCAL // 2]
    if len(column) <= LOCAL:
        return 0.0
    left = (column - savgol_filter(column, LOCAL, ORDER))[LOCAL // 2 : -(LOCAL // 2)]
    return _deviation(left) / float(np.sqrt(1.0 - centre))


def whiteness(column: Array) -> float:
    """Return a channel's noise near the Nyquist frequency in that of all that is fast: one if it is white."""
    return _fast(column) / max(spread(column), 1e-12)


def _pooled(parts: Sequence[Array], deviation: Callable[[Array], float]) -> float:
    """Return the root mean square of some parts' deviations, weighted by what local polynomials leave free."""
    free = np.array([max(len(part) - LOCAL, 0) for part in parts])
    squares = np.array([deviation(part) ** 2 for part in parts])
    return float(np.sqrt(squares @ free / max(free.sum(), 1)))


def _fast(column: Array) -> float:
    """Return the standard deviation that white noise would have, by what is near the Nyquist frequency."""
    top = np.diff(column, TOP) / np.sqrt(comb(2 * TOP, TOP))
    return _deviation(top) if len(top) else 0.0


def _deviation(noise: Array) -> float:
    """Return the standard deviation about zero that a normal distribution of this median would have."""
    return 1.4826 * float(np.median(np.abs(noise)))
