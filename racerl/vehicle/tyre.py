"""The Magic Formula 6.1 tyre: steady-state forces under combined longitudinal and lateral slip.

Source: H. B. Pacejka, Tire and Vehicle Dynamics, 3rd ed., 2012, section 4.3.2 (equation numbers 4.E…). Coefficients
carry the names of the literature. Left out, because a single-track car on solid tyres has neither: camber (γ = 0),
inflation pressure (dp_i = 0) and turn slip (ζ_i = 1).

Axes and signs (wheel frame, x forward, y left): κ = (ω − V_cx)/|V_cx| with ω the surface speed of the wheel, and
α* = tan α = −V_cy/|V_cx|; positive slip gives positive force, so K_xκ > 0 and K_yα > 0.
"""

from dataclasses import dataclass

from racerl.vehicle.ops import Ops, Scalar
from racerl.vehicle.parameter import parameter


def cos_atan(x: Scalar, ops: Ops) -> Scalar:
    """Return cos(atan x) = 1/√(1 + x²)."""
    return 1.0 / ops.sqrt(1.0 + x * x)


def magic_angle(B: Scalar, C: Scalar, E: Scalar, slip: Scalar, ops: Ops) -> Scalar:
    """Return C·atan(B·x − E·(B·x − atan(B·x))), whose sine or cosine is the Magic Formula."""
    stretched = B * slip
    return C * ops.atan(stretched - E * (stretched - ops.atan(stretched)))


def positive(weight: Scalar, ops: Ops) -> Scalar:
    """Return a weight of combined slip, zero where C > 1 would turn the force round: a sliding tyre drives no car."""
    return 0.5 * (weight + ops.abs(weight))  # not max(weight, 0): compiled gradients would be three times slower


@dataclass(frozen=True, kw_only=True)
class MagicFormula:
    """One axle's tyre. F_x, F_y in N for a vertical load F_z in N; slips are ratios."""

    F_z0: Scalar = parameter("N", 0.5, 20000.0, "nominal load F_z0")
    # longitudinal, pure slip (4.E9–4.E18)
    p_Cx1: Scalar = parameter("", 0.3, 3.0, "shape factor C_x")
    p_Dx1: Scalar = parameter("", 0.05, 3.0, "peak friction at F_z0")
    p_Dx2: Scalar = parameter("", -1.0, 1.0, "change of friction with load", 0.0)
    p_Ex1: Scalar = parameter("", -20.0, 1.0, "curvature at F_z0")
    p_Ex2: Scalar = parameter("", -5.0, 5.0, "change of curvature with load", 0.0)
    p_Ex3: Scalar = parameter("", -5.0, 5.0, "change of curvature with load squared", 0.0)
    p_Ex4: Scalar = parameter("", -1.0, 1.0, "change of curvature between drive and brake", 0.0)
    p_Kx1: Scalar = parameter("", 0.2, 100.0, "slip stiffness K_xκ/F_z at F_z0")
    p_Kx2: Scalar = parameter("", -50.0, 50.0, "change of slip stiffness with load", 0.0)
    p_Kx3: Scalar = parameter("", -5.0, 5.0, "exponent of slip stiffness with load", 0.0)
    p_Hx1: Scalar = parameter("", -0.1, 0.1, "horizontal shift at F_z0", 0.0)
    p_Hx2: Scalar = parameter("", -0.1, 0.1, "change of horizontal shift with load", 0.0)
    p_Vx1: Scalar = parameter("", -0.2, 0.2, "vertical shift S_Vx/F_z at F_z0", 0.0)
    p_Vx2: Scalar = parameter("", -0.2, 0.2, "change of vertical shift with load", 0.0)
    # lateral, pure slip (4.E19–4.E30)
    p_Cy1: Scalar = parameter("", 0.3, 3.0, "shape factor C_y")
    p_Dy1: Scalar = parameter("", 0.05, 3.0, "peak friction at F_z0")
    p_Dy2: Scalar = parameter("", -1.0, 1.0, "change of friction with load", 0.0)
    p_Ey1: Scalar = parameter("", -20.0, 1.0, "curvature at F_z0")
    p_Ey2: Scalar = parameter("", -5.0, 5.0, "change of curvature with load", 0.0)
    p_Ey3: Scalar = parameter("", -1.0, 1.0, "change of curvature between left and right", 0.0)
    p_Ky1: Scalar = parameter("", 0.2, 200.0, "largest cornering stiffness K_yα/F_z0")
    p_Ky2: Scalar = parameter("", 0.1, 20.0, "load, in F_z0, at which K_yα is largest", 2.0)
    p_Ky4: Scalar = parameter("", 0.5, 4.0, "shape of K_yα over load", 2.0)
    p_Hy1: Scalar = parameter("", -0.1, 0.1, "horizontal shift at F_z0", 0.0)
    p_Hy2: Scalar = parameter("", -0.1, 0.1, "change of horizontal shift with load", 0.0)
    p_Vy1: Scalar = parameter("", -0.2, 0.2, "vertical shift S_Vy/F_z at F_z0", 0.0)
    p_Vy2: Scalar = parameter("", -0.2, 0.2, "change of vertical shift with load", 0.0)
    # longitudinal, combined slip (4.E50–4.E57)
    r_Bx1: Scalar = parameter("", 0.0, 50.0, "slope of G_xα at κ = 0")
    r_Bx2: Scalar = parameter("", -50.0, 50.0, "change of that slope with κ")
    r_Cx1: Scalar = parameter("", 0.1, 2.0, "shape of G_xα")
    r_Ex1: Scalar = parameter("", -20.0, 1.0, "curvature of G_xα", 0.0)
    r_Ex2: Scalar = parameter("", -5.0, 5.0, "change of that curvature with load", 0.0)
    r_Hx1: Scalar = parameter("", -0.1, 0.1, "shift of G_xα", 0.0)
    # lateral, combined slip (4.E58–4.E67)
    r_By1: Scalar = parameter("", 0.0, 50.0, "slope of G_yκ at α = 0")
    r_By2: Scalar = parameter("", -50.0, 50.0, "change of that slope with α")
    r_By3: Scalar = parameter("", -1.0, 1.0, "shift of α in that slope", 0.0)
    r_Cy1: Scalar = parameter("", 0.1, 2.0, "shape of G_yκ")
    r_Ey1: Scalar = parameter("", -20.0, 1.0, "curvature of G_yκ", 0.0)
    r_Ey2: Scalar = parameter("", -5.0, 5.0, "change of that curvature with load", 0.0)
    r_Hy1: Scalar = parameter("", -0.1, 0.1, "shift of G_yκ", 0.0)
    r_Hy2: Scalar = parameter("", -0.1, 0.1, "change of that shift with load", 0.0)
    r_Vy1: Scalar = parameter("", -1.0, 1.0, "κ-induced side force S_Vyκ/(μ_y F_z)", 0.0)
    r_Vy2: Scalar = parameter("", -1.0, 1.0, "its change with load", 0.0)
    r_Vy4: Scalar = parameter("", -50.0, 50.0, "its change with α", 0.0)
    r_Vy5: Scalar = parameter("", -10.0, 10.0, "its shape over κ", 0.0)
    r_Vy6: Scalar = parameter("", -50.0, 50.0, "its slope over κ", 0.0)

    def forces(self, kappa: Scalar, alpha: Scalar, F_z: Scalar, friction: Scalar, ops: Ops) -> tuple[Scalar, Scalar]:
        """Return (F_x, F_y) in N for slip ratio κ, α* = tan α, load F_z in N and friction scale λ_μ."""
        df_z = (F_z - self.F_z0) / self.F_z0  # 4.E2a
        F_x0 = self.longitudinal(kappa, F_z, df_z, friction, ops)
        F_y0, mu_y = self.lateral(alpha, F_z, df_z, friction, ops)
        F_x = F_x0 * self.longitudinal_weight(kappa, alpha, df_z, ops)
        F_y = F_y0 * self.lateral_weight(kappa, alpha, df_z, ops)
        return F_x, F_y + self.ply_steer(kappa, alpha, mu_y * F_z, df_z, ops)

    def longitudinal(self, kappa: Scalar, F_z: Scalar, df_z: Scalar, friction: Scalar, ops: Ops) -> Scalar:
        """Return the pure-slip force F_x0 (4.E9–4.E18)."""
        kappa_x = kappa + self.p_Hx1 + self.p_Hx2 * df_z
        D_x = (self.p_Dx1 + self.p_Dx2 * df_z) * friction * F_z
        curvature = self.p_Ex1 + (self.p_Ex2 + self.p_Ex3 * df_z) * df_z
        E_x = ops.minimum(curvature * (1.0 - self.p_Ex4 * ops.sign(kappa_x)), 1.0)
        K_x = F_z * (self.p_Kx1 + self.p_Kx2 * df_z) * ops.exp(self.p_Kx3 * df_z)
        S_Vx = F_z * (self.p_Vx1 + self.p_Vx2 * df_z) * friction
        return D_x * ops.sin(magic_angle(K_x / (self.p_Cx1 * D_x), self.p_Cx1, E_x, kappa_x, ops)) + S_Vx

    def lateral(self, alpha: Scalar, F_z: Scalar, df_z: Scalar, friction: Scalar, ops: Ops) -> tuple[Scalar, Scalar]:
        """Return the pure-slip force F_y0 and the friction μ_y (4.E19–4.E30)."""
        alpha_y = alpha + self.p_Hy1 + self.p_Hy2 * df_z
        mu_y = (self.p_Dy1 + self.p_Dy2 * df_z) * friction
        D_y = mu_y * F_z
        curvature = self.p_Ey1 + self.p_Ey2 * df_z
        E_y = ops.minimum(curvature * (1.0 - self.p_Ey3 * ops.sign(alpha_y)), 1.0)
        K_y = self.p_Ky1 * self.F_z0 * ops.sin(self.p_Ky4 * ops.atan(F_z / (self.p_Ky2 * self.F_z0)))
        S_Vy = F_z * (self.p_Vy1 + self.p_Vy2 * df_z) * friction
        return D_y * ops.sin(magic_angle(K_y / (self.p_Cy1 * D_y), self.p_Cy1, E_y, alpha_y, ops)) + S_Vy, mu_y

    def longitudinal_weight(self, kappa: Scalar, alpha: Scalar, df_z: Scalar, ops: Ops) -> Scalar:
        """Return G_xα > 0, the loss of F_x by lateral slip (4.E50–4.E57); 1 at α = 0."""
        B = self.r_Bx1 * cos_atan(self.r_Bx2 * kappa, ops)
        E = ops.minimum(self.r_Ex1 + self.r_Ex2 * df_z, 1.0)
        at_slip = ops.cos(magic_angle(B, self.r_Cx1, E, alpha + self.r_Hx1, ops))
        return positive(at_slip, ops) / ops.cos(magic_angle(B, self.r_Cx1, E, self.r_Hx1, ops))

    def lateral_weight(self, kappa: Scalar, alpha: Scalar, df_z: Scalar, ops: Ops) -> Scalar:
        """Return G_yκ > 0, the loss of F_y by longitudinal slip (4.E58–4.E65); 1 at κ = 0."""
        B = self.r_By1 * cos_atan(self.r_By2 * (alpha - self.r_By3), ops)
        E = ops.minimum(self.r_Ey1 + self.r_Ey2 * df_z, 1.0)
        shift = self.r_Hy1 + self.r_Hy2 * df_z
        at_slip = ops.cos(magic_angle(B, self.r_Cy1, E, kappa + shift, ops))
        return positive(at_slip, ops) / ops.cos(magic_angle(B, self.r_Cy1, E, shift, ops))

    def ply_steer(self, kappa: Scalar, alpha: Scalar, D_y: Scalar, df_z: Scalar, ops: Ops) -> Scalar:
        """Return S_Vyκ, the side force that longitudinal slip induces (4.E66–4.E67), in N."""
        D = D_y * (self.r_Vy1 + self.r_Vy2 * df_z) * cos_atan(self.r_Vy4 * alpha, ops)
        return D * ops.sin(self.r_Vy5 * ops.atan(self.r_Vy6 * kappa))
