"""The hidden cars: a published F1TENTH car with every parameter drawn anew within ±10 %.

The numbers are those printed for the car of "On learning racing policies with reinforcement learning" (IROS 2025), its
tyres as Magic Formula 6.1 coefficients. `front.` and `rear.` head the coefficients of an axle's tyres.
"""

from collections.abc import Sequence

import numpy as np

from tests.gap.plant.tyre import Array

BODY: dict[str, float] = {
    "mass": 5.1,  # kg
    "yaw_inertia": 0.1458,  # kg m²
    "wheelbase": 0.33,  # m
    "l_f": 0.1568,  # m, front axle to CoG
    "friction": 0.8,  # common friction factor
    "drag_constant": 8.5e-4,  # N
    "drag_linear": 5.9e-4,  # N s/m
    "drag_quadratic": 2.8e-4,  # N s²/m²
    "steering_time": 0.044,  # s, T_δ
    "drive_time": 0.046,  # s, T_ω
}
FRONT: dict[str, float] = {
    "F_z0": 26.26,  # N
    "p_Cx1": 0.7011,
    "p_Dx1": 0.8016,
    "p_Ex1": 0.00408,
    "p_Kx1": 1.268,
    "p_Cy1": 0.8352,
    "p_Dy1": 0.6436,
    "p_Ey1": -0.1572,
    "p_Ky1": 1.643,
    "r_Bx1": 2.364,
    "r_Bx2": 2.885,
    "r_Cx1": 0.957,
    "r_Ex1": 0.3592,
    "r_By1": 3.062,
    "r_By2": 2.527,
    "r_Cy1": 1.0,
    "r_Ey1": 0.03632,
}
REAR: dict[str, float] = {
    "F_z0": 23.77,  # N
    "p_Cx1": 1.563,
    "p_Dx1": 0.8299,
    "p_Ex1": -3.979,
    "p_Kx1": 5.848,
    "p_Cy1": 0.6811,
    "p_Dy1": 0.7975,
    "p_Ey1": -2.169,
    "p_Ky1": 2.294,
    "r_Bx1": 8.403,
    "r_Bx2": 7.355,
    "r_Cx1": 1.0,
    "r_Ex1": -0.7696,
    "r_By1": 2.847,
    "r_By2": 2.125,
    "r_Cy1": 1.0,
    "r_Ey1": -0.6291,
}
PUBLISHED: dict[str, float] = (
    BODY | {f"front.{k}": v for k, v in FRONT.items()} | {f"rear.{k}": v for k, v in REAR.items()}
)

KNOWN = ("wheelbase", "front.F_z0", "rear.F_z0")  # a ruler's and a formula's constants: the same for every car
WEIGHT_SHAPES = ("front.r_Cx1", "front.r_Cy1", "rear.r_Cx1", "rear.r_Cy1")  # above 1 a force would change its sign


def draw(rng: np.random.Generator, spread: float = 0.1) -> dict[str, float]:
    """One hidden car: every parameter × U(1 − spread, 1 + spread), except those of `KNOWN`."""
    car = {name: value * rng.uniform(1 - spread, 1 + spread) for name, value in PUBLISHED.items()}
    car |= {name: PUBLISHED[name] for name in KNOWN}
    return car | {name: min(car[name], 1.0) for name in WEIGHT_SHAPES}


def stack(cars: Sequence[dict[str, float]]) -> dict[str, Array]:
    """B cars as one dictionary of arrays (B,)."""
    return {name: np.array([car[name] for car in cars]) for name in cars[0]}
