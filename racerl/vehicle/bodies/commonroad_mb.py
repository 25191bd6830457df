"""CommonRoad's multi-body car, as small as ours: an outsider's model of 29 states.

Sprung mass with roll, pitch and heave, two axles that roll, heave and give way sideways, four wheels of their own
speed on PAC2002 tyres. Source: M. Althoff, G. Würsching, CommonRoad: Vehicle Models, 2020 (package
commonroad-vehicle-models, vehicle 2, a BMW 320i).

Scaled by Froude's law, which keeps gravity and slips: with lengths λ = wheelbase/2.58 m and masses μ = mass/1093 kg,
times go with √λ, velocities with √λ, accelerations with 1; inertias μλ², springs μ/λ, dampers μ/√λ, torsion μλ. At a
wheelbase of 0.33 m it weighs on its tyres like an F1TENTH car, rolls at 3° and has its centre of gravity 0.074 m high.

Ours in it: the configured actuators (steering δ̇ = (δ_ref − δ)/T; a torque that asks for the acceleration
(ω_ref − ω)/T, ω the mean of the wheels), split evenly over four wheels by open differentials, and no limit but
CommonRoad's acceleration of 11.5 m/s². A wheel that rolls backwards has no slip in the source: such a car fails.
"""

import importlib.util
import math
from collections.abc import Sequence
from typing import Any

from racerl.errors import VehicleError
from racerl.vehicle.actuator import FirstOrder
from racerl.vehicle.vehicle import GRAVITY, Vehicle

# parameters by what they scale with
LENGTHS = ("a", "b", "h_s", "h_cg", "R_w", "T_f", "T_r", "h_raf", "h_rar", "l", "w")
MASSES = ("m", "m_s", "m_uf", "m_ur")
INERTIAS = ("I_Phi_s", "I_y_s", "I_z", "I_xz_s", "I_uf", "I_ur", "I_y_w")
SPRINGS = ("K_sf", "K_sr", "K_zt", "K_ras")
DAMPERS = ("K_sdf", "K_sdr", "K_rad")
TORSIONS = ("K_tsf", "K_tsr")
BIG = 2  # CommonRoad's number of the BMW 320i
STEERING_RATE, SPEED = 50.0, 50.0  # rad/s, m/s: beyond what actuators ask for
STEP = 2e-4  # s
STABLE = 2.0  # of 2.8, the largest |λ h| that Runge–Kutta steps of fourth order bear
STANDING = 0.1  # m/s, below which the source drives kinematically, without slip
X, Y, DELTA, V_X, YAW, YAW_RATE, V_Y, WHEELS = 0, 1, 2, 3, 4, 5, 10, slice(23, 27)


class CommonroadMb:
    """The car; its own state is the source's list of 29."""

    def __init__(self, vehicle: Vehicle) -> None:
        if importlib.util.find_spec("vehiclemodels") is None:
            raise VehicleError(
                "body commonroad_mb needs CommonRoad's models: in your clone, pip install -e '.[commonroad]'"
            )
        if not isinstance(vehicle.steering, FirstOrder) or not isinstance(vehicle.drive, FirstOrder):
            raise VehicleError("body commonroad_mb follows wheel speeds through actuators; give sim=default")
        from vehiclemodels.init_mb import init_mb
        from vehiclemodels.vehicle_dynamics_mb import vehicle_dynamics_mb

        self._init, self._dynamics = init_mb, vehicle_dynamics_mb
        self.parameters = scaled(float(vehicle.wheelbase), float(vehicle.mass))
        p = self.parameters
        # s per m/s: a wheel's slip settles at the rate p_Kx1 F_z R²/(I |v_x|), which no step may outrun
        self._settling = STABLE * p.I_y_w / (p.tire.p_kx1 * (p.m * GRAVITY / 4.0) * p.R_w**2)
        self._times = float(vehicle.steering.time_constant), float(vehicle.drive.time_constant)

    def begin(self, shown: Sequence[float]) -> list[float]:
        """Return the car in a motion, level, its wheels at their speed."""
        x, y, yaw, v_x, v_y, yaw_rate, delta, omega = shown
        own: list[float] = self._init(
            [x, y, delta, math.hypot(v_x, v_y), yaw, yaw_rate, math.atan2(v_y, v_x)], self.parameters
        )
        own[WHEELS] = [max(omega, 0.0) / self.parameters.R_w] * 4
        return own

    def show(self, own: list[float]) -> list[float]:
        """Return the rows of STATE."""
        return [own[X], own[Y], own[YAW], own[V_X], own[V_Y], own[YAW_RATE], own[DELTA], self.speed(own)]

    def speed(self, own: Sequence[float]) -> float:
        """Return the mean surface speed of the wheels in m/s, the motor's."""
        return float(self.parameters.R_w * sum(own[WHEELS]) / 4.0)

    def advance(self, own: list[float], command: tuple[float, float], seconds: float) -> list[float]:
        """Return the state after a command, by Runge–Kutta steps as short as the wheels' slip needs."""
        left = seconds
        while left > 1e-9:
            slow = abs(own[V_X]) < STANDING
            step = min(left, STEP, STEP if slow else abs(own[V_X]) * self._settling)
            own = self._step(own, command, step)
            left -= step
        return own

    def _step(self, own: list[float], command: tuple[float, float], h: float) -> list[float]:
        k_1 = self._rates(own, command)
        k_2 = self._rates(_along(own, k_1, h / 2), command)
        k_3 = self._rates(_along(own, k_2, h / 2), command)
        k_4 = self._rates(_along(own, k_3, h), command)
        total = [a + 2.0 * (b + c) + d for a, b, c, d in zip(k_1, k_2, k_3, k_4, strict=True)]
        moved = _along(own, total, h / 6)
        standing = abs(moved[V_X]) < STANDING  # nothing holds the source's wheels then: they would race
        wheels = [moved[V_X] / self.parameters.R_w] * 4 if standing else moved[WHEELS]
        moved[WHEELS] = [max(wheel, 0.0) for wheel in wheels]  # they never turn backwards
        return moved

    def _rates(self, own: list[float], command: tuple[float, float]) -> list[float]:
        steering, drive = self._times
        asked = [(command[0] - own[DELTA]) / steering, (command[1] - self.speed(own)) / drive]
        rates: list[float] = self._dynamics(own, asked, self.parameters)
        return rates


def _along(own: Sequence[float], rates: Sequence[float], h: float) -> list[float]:
    return [x + h * rate for x, rate in zip(own, rates, strict=True)]


def scaled(wheelbase: float, mass: float) -> Any:
    """Return CommonRoad's parameters of a car of that wheelbase in m and mass in kg, similar by Froude's law."""
    from vehiclemodels.vehicle_parameters import setup_vehicle_parameters

    p = setup_vehicle_parameters(BIG)
    length, weight = wheelbase / (p.a + p.b), mass / p.m
    factors = {
        LENGTHS: length,
        MASSES: weight,
        INERTIAS: weight * length**2,
        SPRINGS: weight / length,
        DAMPERS: weight / math.sqrt(length),
        TORSIONS: weight * length,
        ("K_lt",): length / weight,  # m/N
        ("D_f", "D_r"): 1.0 / length,  # rad/m
        ("E_f", "E_r"): 1.0 / length**2,
    }
    for names, factor in factors.items():
        for name in names:
            setattr(p, name, getattr(p, name) * factor)
    p.tire.p_vx1 /= weight  # the source adds p_vx1 F_z to an angle, so it is 1/N
    p.T_sb = p.T_se = 0.5
    p.steering.v_min, p.steering.v_max = -STEERING_RATE, STEERING_RATE
    p.longitudinal.v_min, p.longitudinal.v_max, p.longitudinal.v_switch = -SPEED, SPEED, SPEED
    return p
