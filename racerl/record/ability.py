"""What a driver expects of the configured car: its braking, its grip in turns and the steering that these take.

Quasi-steady: each axle carries its share of m·a_y, so the slip angle of an axle is where F_y/F_z = a_y/g, and the
steering angle of a turn of curvature κ is δ = atan(L·κ) + α_f(a_y) − α_r(a_y).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from racerl.vehicle.ops import TORCH
from racerl.vehicle.vehicle import GRAVITY, Vehicle

LOCKED = -1.0  # slip ratio of locked wheels, which stop any car along its course
STEEPEST = 0.35  # slip α* up to which grip is counted on
POINTS = 36


def braking(vehicle: Vehicle) -> float:
    """Return the deceleration in m/s² that both axles give with locked wheels."""
    F_zf, F_zr = _static_loads(vehicle)
    front, _ = vehicle.front.forces(LOCKED, 0.0, F_zf, vehicle.friction, TORCH)
    rear, _ = vehicle.rear.forces(LOCKED, 0.0, F_zr, vehicle.friction, TORCH)
    return -float(front + rear) / float(vehicle.mass)


@dataclass(frozen=True)
class Cornering:
    """Lateral acceleration over slip α* of both axles, each of shape (P,), in m/s²."""

    wheelbase: float  # m
    slip: NDArray[np.float64]
    front: NDArray[np.float64]
    rear: NDArray[np.float64]

    @classmethod
    def of(cls, vehicle: Vehicle) -> "Cornering":
        """Tabulate the tyres of a vehicle."""
        slip = np.linspace(0.0, STEEPEST, POINTS)
        F_zf, F_zr = _static_loads(vehicle)

        def carried(force: Callable[[float], float], F_z: float) -> NDArray[np.float64]:
            return np.maximum.accumulate([GRAVITY * force(alpha) / F_z for alpha in slip])

        return cls(
            wheelbase=float(vehicle.wheelbase),
            slip=slip,
            front=carried(
                lambda alpha: float(vehicle.front.forces(0.0, alpha, F_zf, vehicle.friction, TORCH)[1]), F_zf
            ),
            rear=carried(lambda alpha: float(vehicle.rear.forces(0.0, alpha, F_zr, vehicle.friction, TORCH)[1]), F_zr),
        )

    @property
    def grip(self) -> float:
        """Largest lateral acceleration in m/s² that both axles carry."""
        return float(min(self.front[-1], self.rear[-1]))

    def understeer(self, acceleration: NDArray[np.float64] | float) -> NDArray[np.float64]:
        """Return α_f − α_r in rad at a lateral acceleration in m/s², with its sign."""
        size, sign = np.abs(acceleration), np.sign(acceleration)
        return sign * (np.interp(size, self.front, self.slip) - np.interp(size, self.rear, self.slip))

    def speed(self, curvature: NDArray[np.float64], share: float, steering: float) -> NDArray[np.float64]:
        """Return the speeds in m/s at which turns take a share of the grip and at most `steering` rad."""
        steps = np.linspace(0.02, share, POINTS) * self.grip
        possible = np.arctan(self.wheelbase * np.abs(curvature))[:, None] + self.understeer(steps) <= steering
        allowed = np.where(possible, steps, steps[0]).max(axis=1)
        return np.sqrt(allowed / np.maximum(np.abs(curvature), 1e-6))


def _static_loads(vehicle: Vehicle) -> tuple[float, float]:
    weight = float(vehicle.mass) * GRAVITY / float(vehicle.wheelbase)
    return weight * float(vehicle.l_r), weight * float(vehicle.arm)
