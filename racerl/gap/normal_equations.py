"""A stage at a point: the cost of its windows, and their normal equations with the pseudo-Huber loss's weights."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from racerl.estimation.pseudo_huber import pseudo_huber, slope
from racerl.estimation.schur import WindowEquations
from racerl.gap.evidence import Evidence
from racerl.vehicle.rollout import NormalEquations

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Linear(WindowEquations):
    """A stage at a point: cost per window (W,), n of ρ, and the normal equations of each window's (θ, x_0)."""

    cost: Array
    usual: float

    @classmethod
    def of(cls, parts: NormalEquations, size: int, evidence: Evidence) -> "Linear":
        """Split normal equations after their first `size` unknowns."""
        H, g, cost = parts.H, parts.g, parts.squares.sum(axis=1)
        tt, tx, xx = H[:, :size, :size], H[:, :size, size:], H[:, size:, size:]
        return cls(tt, tx, xx, g[:, :size], g[:, size:], cost, usual_cost(evidence, cost))

    @property
    def loss(self) -> float:
        """Summed loss of the windows."""
        return float(pseudo_huber(self.cost, self.usual).sum())

    @property
    def weight(self) -> Array:
        """ρ'(c) of the windows, (W,)."""
        return slope(self.cost, self.usual)

    def mixed(self, M: Array) -> "Linear":
        """Return the same over θ of which the rows' parameters are M θ."""
        return replace(self, tt=M.T @ self.tt @ M, tx=M.T @ self.tx, t=self.t @ M)

    def with_remembered(self, lead: Array) -> "Linear":
        """Return the same over θ that leads initial states, too, by `lead` (W, A, N)."""
        back = lead.transpose(0, 2, 1)
        shared = self.tx @ lead
        return replace(
            self,
            tt=self.tt + shared + shared.transpose(0, 2, 1) + back @ self.xx @ lead,
            tx=self.tx + back @ self.xx,
            t=self.t + np.einsum("wna,wa->wn", back, self.x),
        )

    def reduced(self, damping: float = 0.0) -> tuple[Array, Array]:
        """Return H (W, N, N) and g (W, N) over θ with each window's initial state eliminated, weighted by ρ'(c)."""
        H, g = super().reduced(damping)
        return self.weight[:, None, None] * H, self.weight[:, None] * g


def usual_cost(evidence: Evidence, cost: Array) -> float:
    """Return n, the cost of a stage's usual window: that of noise, or what half of the windows have and more."""
    return max(float(evidence.numbers), float(np.median(cost)))
