"""The derivative against CommonRoad's single-track drift model, with its tyre plugged into our car."""

import math

import numpy as np
import torch
from vehiclemodels.utils import tire_model
from vehiclemodels.vehicle_dynamics_std import vehicle_dynamics_std
from vehiclemodels.vehicle_parameters import setup_vehicle_parameters

from racerl.vehicle.actuator import FirstOrder
from racerl.vehicle.ops import TORCH
from racerl.vehicle.vehicle import Vehicle

STATES = 10_000


class OracleTyre:
    """CommonRoad's PAC2002 tyre; its slips have the opposite sign of ours and its α is an angle."""

    def __init__(self, coefficients):
        self.p = coefficients

    def forces(self, kappa, alpha, F_z, friction, ops):
        pairs = [self._one(-k, -math.atan(a), F_z) for k, a in zip(kappa.tolist(), alpha.tolist(), strict=True)]
        return tuple(torch.tensor(pairs, dtype=kappa.dtype).T)

    def _one(self, s, a, F_z):
        F_x0 = tire_model.formula_longitudinal(s, 0, F_z, self.p)
        F_y0, mu_y = tire_model.formula_lateral(a, 0, F_z, self.p)
        return (
            tire_model.formula_longitudinal_comb(s, a, F_x0, self.p),
            tire_model.formula_lateral_comb(s, a, 0, mu_y, F_z, F_y0, self.p),
        )


def test_derivative_agrees_with_commonroad():
    p = setup_vehicle_parameters(2)
    actuator = FirstOrder(time_constant=0.1)
    car = Vehicle(
        mass=p.m,
        yaw_inertia=p.I_z,
        wheelbase=p.a + p.b,
        l_f=p.a,
        front=OracleTyre(p.tire),
        rear=OracleTyre(p.tire),
        steering=actuator,
        drive=actuator,
    )
    draw = np.random.default_rng(0).uniform
    speed, beta = draw(0.6, 50.0, STATES), draw(-0.5, 0.5, STATES)
    yaw, delta, yaw_rate = draw(-math.pi, math.pi, STATES), draw(-0.5, 0.5, STATES), draw(-1.0, 1.0, STATES)
    omega = speed * draw(0.5, 1.5, STATES)
    v_x, v_y = speed * np.cos(beta), speed * np.sin(beta)
    # the regularised wheel speed must be exact: both models take |V_x| above the standstill speed
    front_speed = v_x * np.cos(delta) + (v_y + p.a * yaw_rate) * np.sin(delta)
    use = (front_speed > 0.5) & (v_x > 0.5)
    assert use.sum() > 0.9 * STATES

    expected = []
    for i in range(STATES):
        wheel = omega[i] / p.R_w
        state = [0.0, 0.0, delta[i], speed[i], yaw[i], yaw_rate[i], beta[i], wheel, wheel]
        f = vehicle_dynamics_std(state, [0.0, 0.0], p)
        # it blends with a kinematic model whose accelerations are zero for zero input: undo the blend
        w = 0.5 * (math.tanh((speed[i] - 0.2) / 0.05) + 1)
        dv, dbeta = f[3] / w, f[6] / w
        expected.append(
            [
                f[0],
                f[1],
                dv * math.cos(beta[i]) - v_y[i] * dbeta,
                dv * math.sin(beta[i]) + v_x[i] * dbeta,
                f[5] / w,
            ]
        )
    rows = [np.zeros(STATES), np.zeros(STATES), yaw, v_x, v_y, yaw_rate, delta, omega]
    state = torch.tensor(np.array(rows))
    got = car.derivative(state, torch.zeros(2, STATES, dtype=torch.float64), TORCH)[[0, 1, 3, 4, 5]].T.numpy()
    expected = np.array(expected)
    scale = np.maximum(np.abs(expected), 1e-2 * np.sqrt(np.mean(expected**2, axis=0)))
    assert (np.abs(got - expected) / scale)[use].max() < 1e-9
