"""Steering angle and motor current, the commands of a human driver; needs sim=motor_current."""

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from racerl.env.actions import check_limits


@dataclass(frozen=True)
class Current:
    """[−1, 1]² → steering angle and current."""

    steering_max: float = 0.5  # rad
    drive_max: float = 60.0  # A
    rate_max: float = 1200.0  # A/s, only scales the observed change of current
    drive_mode: ClassVar[str] = "motor_current"
    integrated: ClassVar[bool] = False

    def __post_init__(self) -> None:
        check_limits(self.steering_max, self.drive_max, self.rate_max)

    @property
    def drive_min(self) -> float:
        """Least drive reference in A."""
        return -self.drive_max

    def command(self, action: Tensor, last: Tensor, dt: float) -> Tensor:
        """Scale both outputs."""
        return torch.stack([action[:, 0] * self.steering_max, action[:, 1] * self.drive_max])

    def initial(self, omega: Tensor) -> Tensor:
        """Return no current."""
        return torch.zeros_like(omega)
