"""Tyres of other families than the Magic Formula, with its slip stiffness K and peak D in either direction.

s = |(K_x κ/D_x, K_y α*/D_y)|;  F_x = D_x g(s) (K_x κ/D_x)/s, F_y likewise;  g(0) = 0, g'(0) = 1.
"""

from collections.abc import Callable

import numpy as np

from tests.gap.plant.tyre import Array, Curves, forces

FADING = 0.02  # of Burckhardt's curve per unit of s, beyond its peak
SLIDING = 0.8  # of TMsimple's peak, far beyond it
LARGEST = 30.0  # s, beyond which no curve falls further
ROUND = np.pi - np.arcsin(SLIDING)


def brush(s: Array) -> Array:
    """Bristles under a parabolic pressure: s − s²/3 + s³/27 until all of them slide (Fiala's curve, too)."""
    x = np.minimum(s, 3.0)
    return x - x**2 / 3.0 + x**3 / 27.0


def dugoff(s: Array) -> Array:
    """Bristles under an even pressure: s until the first of them slides, then 1 − 1/(4 s) (Dugoff, 1969)."""
    return np.where(s < 0.5, s, 1.0 - 0.25 / np.maximum(s, 0.5))


def burckhardt(s: Array) -> Array:
    """1.1 (1 − exp(−b s)) − c s (Burckhardt, 1993): the peak is followed by a steady fall."""
    x = np.minimum(s, LARGEST)
    return 1.1 * (1.0 - np.exp(-(1.0 + FADING) / 1.1 * x)) - FADING * x


def tm_simple(s: Array) -> Array:
    """Return sin(B (1 − exp(−s/B))) with B = π − asin(what is left far beyond the peak) (Hirschberg's TMsimple)."""
    curve: Array = np.sin(ROUND * (1.0 - np.exp(-s / ROUND)))
    return curve


FAMILIES: dict[str, Callable[[Array], Array]] = {
    "brush": brush,
    "dugoff": dugoff,
    "burckhardt": burckhardt,
    "tm_simple": tm_simple,
}
MAGIC_FORMULA = "magic_formula"
TYRES = (MAGIC_FORMULA, *FAMILIES)


def forces_of(family: str) -> Callable[[Curves, Array], Array]:
    """What gives F_x and F_y in N, (2, W, B), from a family's curves and κ and α* stacked the same way."""
    if family == MAGIC_FORMULA:
        return forces
    shape = FAMILIES[family]

    def of_family(curves: Curves, slip: Array) -> Array:
        apart = curves.stiffness * curves.shape * slip  # K/D = B C
        s = np.maximum(np.hypot(apart[0], apart[1]), 1e-12)
        return curves.peak * apart * (shape(s) / s)

    return of_family
