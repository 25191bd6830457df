"""Magic Formula 6.1: pure and combined longitudinal and lateral slip, without camber, pressure and turn slip.

κ = (ω − V_x)/|V_x|,  α* = −V_y/|V_x|;  positive slip gives positive force. ω is a surface speed in m/s.
F_0 = D sin(C atan(B s − E (B s − atan B s))) + S_V with s = slip + S_H,  F_x = G_xα F_x0,  F_y = G_yκ F_y0.
Source: Pacejka & Besselink, Tire and Vehicle Dynamics, 3rd ed., section 4.3.2. The friction factor, λ_μ, scales the
peak of both forces and leaves the slip stiffness as it is.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]

ZERO_BY_DEFAULT = (
    "p_Cx1 p_Dx1 p_Dx2 p_Ex1 p_Ex2 p_Ex3 p_Kx1 p_Kx2 p_Kx3 p_Hx1 p_Hx2 p_Vx1 p_Vx2 "
    "p_Cy1 p_Dy1 p_Dy2 p_Ey1 p_Ey2 p_Ky1 p_Hy1 p_Hy2 p_Vy1 p_Vy2 "
    "r_Bx1 r_Bx2 r_Cx1 r_Ex1 r_Ex2 r_Hx1 r_By1 r_By2 r_By3 r_Cy1 r_Ey1 r_Ey2 r_Hy1 r_Hy2"
)
DEFAULTS: dict[str, float] = dict.fromkeys(ZERO_BY_DEFAULT.split(), 0.0) | {"p_Ky2": 2.0, "p_Ky4": 2.0}
"""Every coefficient but F_z0, with its value where a tyre doesn't list it."""

LOAD_DEPENDENT = (
    "p_Ex2", "p_Ex3", "p_Hx1", "p_Hx2", "p_Vx1", "p_Vx2", "p_Ey2", "p_Hy1", "p_Hy2", "p_Vy1", "p_Vy2",
    "r_Ex2", "r_Hx1", "r_Ey2", "r_Hy1", "r_Hy2",
)  # fmt: skip
"""Without these, all factors but B and D are the same at every load and no curve is shifted."""

LOW_SPEED = 0.5  # m/s, below which |V_x| is replaced by a parabola that stays above LOW_SPEED / 2
LEAST_LOAD = 0.2  # N, keeps a lifted wheel's formula finite


@dataclass(frozen=True)
class Curves:
    """The factors of the formula at one load and friction, x in row 0 and y in row 1, each (2, W, B)."""

    stiffness: Array  # B
    peak: Array  # D, N
    shape: Array  # C
    curvature: Array  # E
    shift: Array  # S_H
    offset: Array  # S_V, N
    weight_stiffness: Array  # r_B1
    weight_fading: Array  # r_B2
    weight_centre: Array  # r_B3
    weight_shape: Array  # r_C1
    weight_curvature: Array  # r_E
    weight_shift: Array  # S_H of the other slip
    is_shifted: bool  # is any S_H of the other slip not zero?


class Tyre:
    """The tyres of W wheels on B cars, from coefficients broadcast to (W, B)."""

    def __init__(self, coefficients: Mapping[str, Array]) -> None:
        unknown = set(coefficients) - set(DEFAULTS) - {"F_z0"}
        if unknown:
            raise KeyError(f"no Magic Formula coefficient {sorted(unknown)}; known: F_z0 {' '.join(DEFAULTS)}")
        self.c: dict[str, Array] = {k: np.asarray(v, float) for k, v in (DEFAULTS | dict(coefficients)).items()}
        self.is_shifted = any(bool(np.any(self.c[k])) for k in ("r_Hx1", "r_Hy1", "r_Hy2"))
        shape = np.broadcast_shapes(*(value.shape for value in self.c.values()))
        depends_on_load = any(bool(np.any(self.c[k])) for k in LOAD_DEPENDENT)
        self.constant = None if depends_on_load else self._other_factors(np.zeros(shape), np.zeros(shape))

    def curves(self, load: Array, friction: Array) -> Curves:
        """The factors at the vertical load in N and the friction factor, both (W, B)."""
        c = self.c
        F_z = np.maximum(load, LEAST_LOAD)
        dfz = (F_z - c["F_z0"]) / c["F_z0"]
        grip = friction * F_z
        peak = _pair((c["p_Dx1"] + c["p_Dx2"] * dfz) * grip, (c["p_Dy1"] + c["p_Dy2"] * dfz) * grip)
        others = self._other_factors(dfz, grip) if self.constant is None else self.constant
        stiffness = self.slip_stiffness(F_z, dfz) / np.maximum(others["shape"] * peak, 1e-6)
        return Curves(stiffness, peak, **others, is_shifted=self.is_shifted)

    def _other_factors(self, dfz: Array, grip: Array) -> dict[str, Array]:
        """All factors but B and D: constant for tyres without any of `LOAD_DEPENDENT`."""
        c = self.c
        E_x = c["p_Ex1"] + (c["p_Ex2"] + c["p_Ex3"] * dfz) * dfz
        return {
            "shape": _pair(c["p_Cx1"] + 0 * dfz, c["p_Cy1"]),
            "curvature": np.minimum(_pair(E_x, c["p_Ey1"] + c["p_Ey2"] * dfz), 1.0),
            "shift": _pair(c["p_Hx1"] + c["p_Hx2"] * dfz, c["p_Hy1"] + c["p_Hy2"] * dfz),
            "offset": _pair((c["p_Vx1"] + c["p_Vx2"] * dfz) * grip, (c["p_Vy1"] + c["p_Vy2"] * dfz) * grip),
            "weight_stiffness": _pair(c["r_Bx1"] + 0 * dfz, c["r_By1"]),
            "weight_fading": _pair(c["r_Bx2"] + 0 * dfz, c["r_By2"]),
            "weight_centre": _pair(0 * dfz, c["r_By3"]),
            "weight_shape": _pair(c["r_Cx1"] + 0 * dfz, c["r_Cy1"]),
            "weight_curvature": np.minimum(_pair(c["r_Ex1"] + c["r_Ex2"] * dfz, c["r_Ey1"] + c["r_Ey2"] * dfz), 1.0),
            "weight_shift": _pair(c["r_Hx1"] + 0 * dfz, c["r_Hy1"] + c["r_Hy2"] * dfz),
        }

    def slip_stiffness(self, F_z: Array, dfz: Array) -> Array:
        """K_xκ = F_z (p_Kx1 + p_Kx2 dfz) exp(p_Kx3 dfz) and K_yα = p_Ky1 F_z0 sin(p_Ky4 atan(F_z/(p_Ky2 F_z0))), N."""
        c = self.c
        K_x = F_z * (c["p_Kx1"] + c["p_Kx2"] * dfz) * np.exp(c["p_Kx3"] * dfz)
        K_y = c["p_Ky1"] * c["F_z0"] * np.sin(c["p_Ky4"] * np.arctan(F_z / (c["p_Ky2"] * c["F_z0"])))
        return _pair(K_x, K_y)


def forces(curves: Curves, slip: Array) -> Array:
    """F_x and F_y in N, (2, W, B), from κ and α* stacked the same way."""
    pure = curves.peak * np.sin(_warped(curves.shape, curves.curvature, curves.stiffness * (slip + curves.shift)))
    return (pure + curves.offset) * _weights(curves, slip)


def slip_speed(V_x: Array) -> Array:
    """|V_x| in m/s, smoothed below `LOW_SPEED` so that slip stays finite at a stop."""
    speed = np.abs(V_x)
    return np.where(speed < LOW_SPEED, (speed * speed + LOW_SPEED**2) / (2 * LOW_SPEED), speed)


def _weights(curves: Curves, slip: Array) -> Array:
    """G_xα, fading F_x as α grows, and G_yκ, fading F_y as κ grows: 1 where the other slip is zero."""
    fading = curves.weight_fading * (slip - curves.weight_centre)
    stiffness = curves.weight_stiffness / np.sqrt(1.0 + fading * fading)  # r_B1 cos(atan(·))
    other = slip[::-1] + curves.weight_shift
    weight = np.cos(_warped(curves.weight_shape, curves.weight_curvature, stiffness * other))
    if curves.is_shifted:
        weight /= np.cos(_warped(curves.weight_shape, curves.weight_curvature, stiffness * curves.weight_shift))
    return weight


def _warped(shape: Array, curvature: Array, slip: Array) -> Array:
    """C atan(s − E (s − atan s)), the argument of every Magic Formula curve."""
    return shape * np.arctan(slip - curvature * (slip - np.arctan(slip)))


def _pair(x: Array, y: Array) -> Array:
    """Stack an x and a y factor to (2, W, B)."""
    both = np.empty((2, *np.broadcast_shapes(np.shape(x), np.shape(y))))
    both[0], both[1] = x, y
    return both
