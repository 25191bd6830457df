"""How many independent numbers residuals that hang together are worth."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def independent_residuals(residuals: Array) -> float:
    """Return how many independent numbers the residuals (T, C, W) are worth: Σ_c T·W/τ_c.

    τ = 1 + 2 Σ ρ_k is the integrated autocorrelation time of a channel, summed until ρ falls below 0.05.
    """
    length, channels, count = residuals.shape
    total = 0.0
    for c in range(channels):
        e = residuals[:, c]
        power = (e**2).mean()
        tau = 1.0
        for lag in range(1, length):
            rho = (e[lag:] * e[:-lag]).mean() / power if power > 0 else 0.0
            if rho < 0.05:
                break
            tau += 2.0 * rho
        total += length * count / tau
    return total
