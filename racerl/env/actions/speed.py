"""Steering angle and wheel speed directly: [−1, 1] → ω_ref in 0.01 … 7 m/s."""

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from racerl.env.actions import OMEGA_REF_MAX, OMEGA_REF_MIN, check_limits


@dataclass(frozen=True)
class Speed:
    """The paper's variant without the integrator."""

    steering_max: float = 0.5  # rad
    drive_max: float = OMEGA_REF_MAX  # m/s
    rate_max: float = 5.0  # m/s², only scales the observed change of ω_ref
    drive_mode: ClassVar[str] = "wheel_speed"
    integrated: ClassVar[bool] = False

    def __post_init__(self) -> None:
        check_limits(self.steering_max, self.drive_max, self.rate_max)

    @property
    def drive_min(self) -> float:
        """Least drive reference in m/s."""
        return OMEGA_REF_MIN

    def command(self, action: Tensor, last: Tensor, dt: float) -> Tensor:
        """Map the second output linearly onto the range of ω_ref."""
        omega_ref = OMEGA_REF_MIN + (action[:, 1] + 1.0) * ((self.drive_max - OMEGA_REF_MIN) / 2)
        return torch.stack([action[:, 0] * self.steering_max, omega_ref])

    def initial(self, omega: Tensor) -> Tensor:
        """Return ω itself."""
        return omega.clamp(OMEGA_REF_MIN, self.drive_max)
