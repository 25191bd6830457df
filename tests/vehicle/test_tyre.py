"""The Magic Formula tyre against its published structure, limits and symmetries."""

import dataclasses
import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from racerl.vehicle.ops import TORCH
from racerl.vehicle.tyre import MagicFormula

F_Z = 20.0
TYRE = MagicFormula(
    F_z0=20.0,
    p_Cx1=1.5,
    p_Dx1=0.9,
    p_Ex1=-0.5,
    p_Kx1=12.0,
    p_Cy1=1.4,
    p_Dy1=0.8,
    p_Ey1=-0.8,
    p_Ky1=9.0,
    r_Bx1=9.0,
    r_Bx2=7.0,
    r_Cx1=1.0,
    r_By1=8.0,
    r_By2=5.0,
    r_Cy1=1.0,
)
slip = st.floats(-3.0, 3.0)
load = st.floats(5.0, 60.0)


def forces(kappa, alpha, F_z=F_Z, friction=1.0, tyre=TYRE):
    return tyre.forces(kappa, alpha, F_z, friction, TORCH)


def test_initial_slopes_are_the_named_stiffnesses():
    h = 1e-6
    K_x = (forces(h, 0.0)[0] - forces(-h, 0.0)[0]) / (2 * h)
    K_y = (forces(0.0, h)[1] - forces(0.0, -h)[1]) / (2 * h)
    assert K_x == pytest.approx(F_Z * 12.0, rel=1e-6)
    assert K_y == pytest.approx(9.0 * 20.0 * math.sin(2.0 * math.atan(1.0 / 2.0)), rel=1e-6)


def test_peak_is_friction_times_load():
    slips = torch.linspace(0, 3, 30001, dtype=torch.float64)
    assert float(forces(slips, torch.zeros_like(slips))[0].max()) == pytest.approx(0.9 * F_Z, rel=1e-5)
    assert float(forces(torch.zeros_like(slips), slips)[1].max()) == pytest.approx(0.8 * F_Z, rel=1e-5)


def test_far_beyond_the_peak_the_force_is_D_sin_half_pi_C():
    """With E < 1 the argument of the outer atan grows without bound: F → D sin(C π/2)."""
    assert forces(1e9, 0.0)[0] == pytest.approx(0.9 * F_Z * math.sin(1.5 * math.pi / 2), rel=1e-6)
    assert forces(0.0, 1e9)[1] == pytest.approx(0.8 * F_Z * math.sin(1.4 * math.pi / 2), rel=1e-6)


@given(slip, slip, load)
def test_unshifted_tyre_is_odd_and_dissipates(kappa, alpha, F_z):
    F_x, F_y = forces(kappa, alpha, F_z)
    assert forces(-kappa, alpha, F_z) == pytest.approx((-F_x, F_y), abs=1e-12)
    assert forces(kappa, -alpha, F_z) == pytest.approx((F_x, -F_y), abs=1e-12)
    assert F_x * kappa >= 0 and F_y * alpha >= 0


@given(slip, slip, load)
def test_combined_slip_never_adds_force(kappa, alpha, F_z):
    assert abs(forces(kappa, alpha, F_z)[0]) <= abs(forces(kappa, 0.0, F_z)[0]) + 1e-12
    assert abs(forces(kappa, alpha, F_z)[1]) <= abs(forces(0.0, alpha, F_z)[1]) + 1e-12


@given(slip, load)
def test_weights_are_one_in_pure_slip(value, F_z):
    df_z = (F_z - TYRE.F_z0) / TYRE.F_z0
    assert TYRE.longitudinal_weight(value, 0.0, df_z, TORCH) == pytest.approx(1.0)
    assert TYRE.lateral_weight(0.0, value, df_z, TORCH) == pytest.approx(1.0)


def test_weights_fall_to_zero_for_C_of_one():
    """cos(C·π/2) = 0 at C = 1: a tyre that only spins carries no side force."""
    assert abs(TYRE.lateral_weight(1e9, 0.0, 0.0, TORCH)) < 1e-6
    assert abs(TYRE.longitudinal_weight(0.0, 1e9, 0.0, TORCH)) < 1e-6


@given(slip, slip, st.floats(0.3, 2.0), st.floats(0.3, 2.0), st.floats(-3.0, 1.0))
def test_no_shape_of_combined_slip_turns_a_force_round(kappa, alpha, C_x, C_y, E):
    tyre = dataclasses.replace(TYRE, r_Cx1=C_x, r_Cy1=C_y, r_Ex1=E, r_Ey1=E)
    F_x, F_y = forces(kappa, alpha, tyre=tyre)
    assert float(F_x) * kappa >= 0.0 and float(F_y) * alpha >= 0.0


@given(st.floats(0.3, 1.5))
def test_friction_scales_the_peak_and_leaves_the_stiffness(friction):
    h = 1e-6
    assert forces(h, 0.0, friction=friction)[0] / h == pytest.approx(F_Z * 12.0, rel=1e-4)
    slips = torch.linspace(0, 3, 3001, dtype=torch.float64)
    peak = float(forces(torch.zeros_like(slips), slips, friction=friction)[1].max())
    assert peak == pytest.approx(0.8 * friction * F_Z, rel=1e-3)


@given(st.floats(0.2, 3.0))
def test_cornering_stiffness_over_load(F_z_ratio):
    """K_yα = p_Ky1 F_z0 sin(p_Ky4 atan(F_z/(p_Ky2 F_z0))), largest at F_z = p_Ky2 F_z0 for p_Ky4 = 2."""
    h = 1e-7
    K_y = forces(0.0, h, F_Z * F_z_ratio)[1] / h
    assert K_y == pytest.approx(9.0 * 20.0 * math.sin(2 * math.atan(F_z_ratio / 2.0)), rel=1e-4)
    assert K_y <= 9.0 * 20.0 * (1 + 1e-6)


@pytest.mark.parametrize(
    "change, moves",
    [
        ({"p_Hy1": 0.02}, lambda t: forces(0.0, -0.02, tyre=t)[1] == pytest.approx(0.0, abs=1e-12)),
        ({"p_Hx1": 0.02}, lambda t: forces(-0.02, 0.0, tyre=t)[0] == pytest.approx(0.0, abs=1e-12)),
        ({"p_Vy1": 0.03}, lambda t: forces(0.0, 0.0, tyre=t)[1] == pytest.approx(0.03 * F_Z)),
        ({"p_Vx1": 0.03}, lambda t: forces(0.0, 0.0, tyre=t)[0] == pytest.approx(0.03 * F_Z)),
        ({"p_Dy2": -0.2}, lambda t: forces(0.0, 0.5, 2 * F_Z, tyre=t)[1] < forces(0.0, 0.5, 2 * F_Z)[1]),
        ({"p_Kx3": -0.5}, lambda t: forces(1e-6, 0.0, 2 * F_Z, tyre=t)[0] < forces(1e-6, 0.0, 2 * F_Z)[0]),
        (
            {"p_Ey3": 0.3},
            lambda t: abs(forces(0.0, 0.5, tyre=t)[1]) != pytest.approx(abs(forces(0.0, -0.5, tyre=t)[1])),
        ),
        (
            {"p_Ex4": 0.3},
            lambda t: abs(forces(0.5, 0.0, tyre=t)[0]) != pytest.approx(abs(forces(-0.5, 0.0, tyre=t)[0])),
        ),
        ({"r_Vy1": 0.1, "r_Vy5": 1.5, "r_Vy6": 8.0}, lambda t: forces(0.1, 0.0, tyre=t)[1] > 0.1),
        ({"r_Hy1": 0.02}, lambda t: t.lateral_weight(0.0, 0.1, 0.0, TORCH) == pytest.approx(1.0)),
        ({"r_Hx1": 0.02}, lambda t: t.longitudinal_weight(0.1, 0.0, 0.0, TORCH) == pytest.approx(1.0)),
        ({"p_Ey1": 1.0, "p_Ey2": 5.0}, lambda t: math.isfinite(forces(0.0, 2.0, 2 * F_Z, tyre=t)[1])),
    ],
)
def test_each_coefficient_does_what_its_name_says(change, moves):
    assert moves(dataclasses.replace(TYRE, **change))
