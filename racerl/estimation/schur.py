"""Normal equations of windows that share parameters θ and have an initial state x_0 each.

    [ tt   tx ] [Δθ ]     [t]
    [ tx^T xx ] [Δx_0] = −[x]

The Schur complement eliminates x_0 window by window: H = tt − tx xx⁻¹ tx^T, g = t − tx xx⁻¹ x.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
RIDGE = 1e-10  # of the largest stiffness of a window, on initial states that it does not tell


@dataclass(frozen=True)
class WindowEquations:
    """The blocks of W windows, N parameters and A initial states: half the Hessian and half the gradient of a cost."""

    tt: Array  # (W, N, N)
    tx: Array  # (W, N, A)
    xx: Array  # (W, A, A)
    t: Array  # (W, N)
    x: Array  # (W, A)

    def inverse(self, damping: float = 0.0) -> Array:
        """Return the damped inverse of xx, (W, A, A)."""
        diagonal = np.einsum("waa->wa", self.xx)
        ridge = damping * diagonal + RIDGE * diagonal.max(axis=1, keepdims=True, initial=0.0) + 1e-300
        return np.linalg.inv(self.xx + ridge[:, :, None] * np.eye(self.xx.shape[1]))

    def reduced(self, damping: float = 0.0) -> tuple[Array, Array]:
        """Return H (W, N, N) and g (W, N) over θ with each window's initial state eliminated."""
        gain = self.tx @ self.inverse(damping)
        return self.tt - gain @ self.tx.transpose(0, 2, 1), self.t - np.einsum("wnx,wx->wn", gain, self.x)

    def follow(self, moved: Array, damping: float = 0.0) -> Array:
        """Return the initial states' own step (A, W) when θ moves by `moved`."""
        gradient = self.x + np.einsum("wnx,n->wx", self.tx, moved)
        return -np.einsum("wxy,wy->xw", self.inverse(damping), gradient)
