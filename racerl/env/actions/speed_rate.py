"""Steering angle and *rate* of the wheel speed: ω_ref ← clamp(ω_ref + a·ω̇_max·dt, 0.01 … 7 m/s)."""

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from racerl.env.actions import OMEGA_REF_MAX, OMEGA_REF_MIN, check_limits


@dataclass(frozen=True)
class SpeedRate:
    """The paper's base action."""

    steering_max: float = 0.5  # rad
    rate_max: float = 5.0  # m/s²
    drive_max: float = OMEGA_REF_MAX  # m/s
    drive_mode: ClassVar[str] = "wheel_speed"
    integrated: ClassVar[bool] = True

    def __post_init__(self) -> None:
        check_limits(self.steering_max, self.drive_max, self.rate_max)

    @property
    def drive_min(self) -> float:
        """Least drive reference in m/s."""
        return OMEGA_REF_MIN

    def command(self, action: Tensor, last: Tensor, dt: float) -> Tensor:
        """Integrate the second output into ω_ref."""
        omega_ref = last[1] + action[:, 1] * (self.rate_max * dt)
        return torch.stack([action[:, 0] * self.steering_max, omega_ref.clamp(OMEGA_REF_MIN, self.drive_max)])

    def initial(self, omega: Tensor) -> Tensor:
        """Return ω itself."""
        return omega.clamp(OMEGA_REF_MIN, self.drive_max)
