"""The published car's tyres against the published curves that they were fitted to."""

import math

import numpy as np
import pytest

from racerl.vehicle.ops import TORCH
from tests.vehicle.conftest import make_car

# published vector: S_p, α_p in degrees, then B, C, D, E lateral and longitudinal
PUBLISHED = {
    "front": (0.1226, 8.156, 0.0571, 0.589, 0.853, 0.231, 2.833, 0.690, 0.810, 0.0066),
    "rear": (0.1323, 7.558, 0.0692, 0.593, 0.860, 4.285, 4.675, 1.579, 0.855, 7.296),
}
FRICTION = 0.8


def published_forces(axle, kappa, alpha):
    """The similarity method with slips normalised by their peaks; forces per load."""
    S_p, alpha_p, B_y, C_y, D_y, E_y, B_x, C_x, D_x, E_x = PUBLISHED[axle]
    a, k = math.degrees(alpha) / alpha_p, kappa / S_p
    S = math.hypot(a, k) or 1e-12

    def curve(B, C, D, E, q):
        return D * math.sin(C * math.atan(q + E * (q - math.atan(q))))

    F_x = k / S * FRICTION * curve(B_x, C_x, D_x, E_x, B_x * S * S_p)
    return F_x, a / S * FRICTION * curve(B_y, C_y, D_y, E_y, B_y * S * alpha_p)


@pytest.mark.parametrize(
    "axle, most_x, most_y, rms_x, rms_y",
    [
        ("front", 0.001, 0.001, 0.001, 0.001),
        ("rear", 0.05, 0.011, 0.015, 0.005),
    ],
)
def test_tyre_follows_the_published_curves(axle, most_x, most_y, rms_x, rms_y):
    car = make_car("vehicle=published")
    tyre = getattr(car, axle)
    misfit = np.array(
        [
            np.subtract(
                np.divide(tyre.forces(kappa, math.tan(alpha), tyre.F_z0, car.friction, TORCH), tyre.F_z0),
                published_forces(axle, kappa, alpha),
            )
            for kappa in np.linspace(-0.4, 0.4, 33)
            for alpha in np.radians(np.linspace(-25, 25, 41))
        ]
    )
    assert (np.abs(misfit).max(axis=0) < (most_x, most_y)).all()
    assert (np.sqrt((misfit**2).mean(axis=0)) < (rms_x, rms_y)).all()


def test_nominal_loads_are_the_static_loads():
    car = make_car("vehicle=published")
    weight = car.mass * 9.81
    assert car.front.F_z0 == pytest.approx(weight * car.l_r / car.wheelbase, abs=0.01)
    assert car.rear.F_z0 == pytest.approx(weight * car.l_f / car.wheelbase, abs=0.01)
