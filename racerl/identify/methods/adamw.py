"""AdamW on the parameters, as in the paper; the initial states follow by a Gauss–Newton step of their own.

The gradient of the rollouts is the compiled kernel's, or torch's by back-propagation through time (`gradient: torch`);
both are the exact gradient of the same sum. θ is scaled by the priors' deviations; the rate falls along a cosine. The
priors take the place of weight decay.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from racerl.errors import ConfigError
from racerl.identify.methods import Fit, require_numbers
from racerl.identify.objective import Objective, Point
from racerl.vehicle.rollout import residuals

SETTLED = 1e-3  # relative gain over the last tenth of the steps, below which the fit has converged
GRADIENTS = ("kernel", "torch")


@dataclass(frozen=True)
class Adamw:
    """First-order descent over all windows."""

    iterations: int = 400
    rate: float = 0.05  # of the priors' deviations
    gradient: str = "kernel"

    def __post_init__(self) -> None:
        if self.gradient not in GRADIENTS:
            raise ConfigError(f"method.gradient = {self.gradient}: allowed is {' or '.join(GRADIENTS)}")
        require_numbers("method", iterations=self.iterations, rate=self.rate)
        if self.iterations < 1 or not 0 < self.rate < 10:
            raise ConfigError(f"method: iterations = {self.iterations}, rate = {self.rate}; allowed is ≥ 1 and 0 … 10")

    def fit(self, objective: Objective, start: Point, on_step: Callable[[int, float], None]) -> Fit:
        """Return the best point found."""
        unknowns, point = objective.unknowns, start
        z = torch.zeros(len(unknowns.names), dtype=torch.float64, requires_grad=True)
        z.data = torch.as_tensor((start.theta - unknowns.start) / unknowns.sigma)
        optimizer = torch.optim.AdamW([z], lr=self.rate, weight_decay=0.0)
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, self.iterations)
        at = objective.linearise(point)
        best, best_at = point, at
        costs = [at.cost]
        for iteration in range(1, self.iterations + 1):
            gradient = at.t.sum(axis=0) if self.gradient == "kernel" else torch_gradient(objective, point)
            # half of the gradient of the cost, in scaled parameters
            z.grad = torch.as_tensor(gradient * unknowns.sigma) + objective.penalty * z.detach()
            optimizer.step()
            schedule.step()
            theta = unknowns.clip(unknowns.start + unknowns.sigma * z.detach().numpy())
            z.data = torch.as_tensor((theta - unknowns.start) / unknowns.sigma)
            point = objective.moved(point, at, theta, 1e-3)
            at = objective.linearise(point)
            if not math.isfinite(at.cost):
                break
            if at.cost < best_at.cost:
                best, best_at = point, at
            costs.append(best_at.cost)
            on_step(iteration, at.cost)
        # the last tenth of the way, at small rates, changes nothing any more
        before = costs[-1 - len(costs) // 10]
        return Fit(best, best_at, iteration, math.isfinite(at.cost) and before - best_at.cost < SETTLED * best_at.cost)


def torch_gradient(objective: Objective, point: Point) -> NDArray[np.float64]:
    """Return half the gradient of the data's share of the cost over θ, by back-propagation through time."""
    theta = torch.as_tensor(point.theta).clone().requires_grad_(True)
    spread = theta[:, None].expand(-1, objective.windows.count)
    error = residuals(objective.rollout, spread, torch.as_tensor(point.initial), objective.windows)
    (0.5 * (error**2).sum()).backward()
    assert theta.grad is not None  # noqa: S101
    return theta.grad.numpy()
