"""Flaws of tyre and load: what changes grip, when force builds up, and what damps the body."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

import numpy as np

from tests.gap.plant.effects.base import Effect, three
from tests.gap.plant.tyre import Array

if TYPE_CHECKING:
    from tests.gap.plant.car import Now, Plant

FULL_TURN = 5.0  # m/s², the lateral acceleration at which losses of grip are quoted


class LongitudinalLoadTransfer(Effect):
    """The body pitches: load moves to the rear under power, 50 ms behind a_x, and no further than 80 % of an axle.

    ȧ_f = (a_x − a_f)/50 ms, ΔF_z = m a_f h/L through tanh, h = `cog_height` in m.
    """

    name = "longitudinal_load_transfer"
    units: ClassVar = {"cog_height": "m"}
    sizes = three(cog_height=(0.025, 0.075, 0.15))
    LAG = 0.05  # s

    def attach(self, plant: Plant) -> None:
        self.lever = plant.cars["mass"] * self.p["cog_height"] / plant.cars["wheelbase"]
        self.most = 0.8 * plant.cars["mass"] * 9.81 / 2

    def n_states(self, n_wheels: int) -> int:
        return 1

    def loads(self, now: Now, load: Array) -> Array:
        moved = self.gate * self.most * np.tanh(self.lever * self.own(now)[0] / self.most) / now.n_front
        shifted = load.copy()
        shifted[: now.n_front] -= moved
        shifted[now.n_front :] += moved
        return shifted

    def rates(self, now: Now) -> Array:
        return (now.a_x - self.own(now)) / self.LAG


class LateralLoadSensitivity(Effect):
    """Grip falls with the lateral acceleration squared: μ/(1 + q (v_x r/5)²); `loss` is the share lost at 5 m/s²."""

    name = "lateral_load_sensitivity"
    units: ClassVar = {"loss": "-"}
    sizes = three(loss=(0.09, 0.25, 0.42))

    def attach(self, plant: Plant) -> None:
        self.q = self.gate * self.p["loss"] / (1.0 - self.p["loss"])

    def grip(self, now: Now, friction: Array) -> Array:
        return friction / (1.0 + self.q * np.square(now.v_x * now.r / FULL_TURN))


class TyreRelaxation(Effect):
    """The side force builds up over a way of σ = `length` m: Ḟ_y = max(|V_x|, 0.3)/σ (F_y,steady − F_y)."""

    name = "tyre_relaxation"
    units: ClassVar = {"length": "m"}
    sizes = three(length=(0.06, 0.18, 0.36))

    def n_states(self, n_wheels: int) -> int:
        return n_wheels

    def forces(self, now: Now, force: Array) -> Array:
        self.steady = force[1].copy()
        force[1] = self.pick(self.own(now), self.steady)
        return force

    def rates(self, now: Now) -> Array:
        return np.maximum(np.abs(now.V_x), 0.3) / self.p["length"] * (self.steady - self.own(now))


class FrictionFade(Effect):
    """Dust: μ (1 − a (1 − exp(−t/120 s))), t since the log began, a = `loss`, the share lost in the end."""

    name = "friction_fade"
    units: ClassVar = {"loss": "-", "time": "s"}
    sizes = three(loss=(0.07, 0.20, 0.38), time=120.0)

    def grip(self, now: Now, friction: Array) -> Array:
        return friction * (1.0 + self.gate * self.p["loss"] * np.expm1(-now.t / self.p["time"]))


class TyreHeating(Effect):
    """Slip power heats the tyres of an axle, and hot tyres grip less: μ exp(−a θ), θ̇ = (P/4 W − θ)/τ.

    P is the axle's slip power in W, θ is 1 in steady hard driving, a = `loss`, τ = `time` in s.
    """

    name = "tyre_heating"
    units: ClassVar = {"loss": "-", "time": "s"}
    sizes = three(loss=(0.08, 0.25, 0.5), time=15.0)
    persists = True
    POWER = 4.0  # W per axle

    def attach(self, plant: Plant) -> None:
        self.power = self.POWER / plant.wheels.n_front

    def n_states(self, n_wheels: int) -> int:
        return n_wheels

    def rest(self, state: Array, seconds: float) -> None:
        state *= np.exp(-seconds / self.p["time"])

    def grip(self, now: Now, friction: Array) -> Array:
        return friction * np.exp(-self.gate * self.p["loss"] * self.own(now))

    def rates(self, now: Now) -> Array:
        heat = np.abs(now.force[0] * now.slip[0] * now.reference) + np.abs(now.force[1] * now.V_y)
        return (heat / self.power - self.own(now)) / self.p["time"]


class SpeedDependentFriction(Effect):
    """Grip falls with speed: μ (1 − a v²/(v² + (3 m/s)²)), a = `loss`, the share lost at very high speed."""

    name = "speed_dependent_friction"
    units: ClassVar = {"loss": "-"}
    sizes = three(loss=(0.13, 0.38, 0.65))

    def grip(self, now: Now, friction: Array) -> Array:
        squared = now.v_x * now.v_x + now.v_y * now.v_y
        return friction * (1.0 - self.gate * self.p["loss"] * squared / (squared + 9.0))


class FrictionPatch(Effect):
    """A slippery spot with soft edges: μ (1 − a exp(−(d/R)⁴)), d each wheel's distance from (`x`, `y`) in m.

    a = `loss`, R = `radius` in m.
    """

    name = "friction_patch"
    units: ClassVar = {"loss": "-", "x": "m", "y": "m", "radius": "m"}
    sizes = three(loss=(0.17, 0.45, 0.75), x=0.0, y=0.0, radius=1.5)
    fixed = ("x", "y")

    def attach(self, plant: Plant) -> None:
        self.X, self.Y = plant.wheels.X, plant.wheels.Y

    def grip(self, now: Now, friction: Array) -> Array:
        across = now.x + now.cos_yaw * self.X - now.sin_yaw * self.Y - self.p["x"]
        along = now.y + now.sin_yaw * self.X + now.cos_yaw * self.Y - self.p["y"]
        inside = np.square((across * across + along * along) / np.square(self.p["radius"]))
        return friction * (1.0 - self.gate * self.p["loss"] * np.exp(-inside))


class CamberThrust(Effect):
    """Worn or cambered tyres push to the left: c F_z (1 − ½ (F_y/μF_z)²) at every wheel that rolls, c = `thrust`."""

    name = "camber_thrust"
    units: ClassVar = {"thrust": "-"}
    sizes = three(thrust=(0.012, 0.035, 0.07))
    signed = ("thrust",)

    def forces(self, now: Now, force: Array) -> Array:
        used = force[1] / (now.friction * now.load)
        push = self.gate * self.p["thrust"] * now.load * np.tanh(np.abs(now.V_x) / 0.3) * (1.0 - 0.5 * used * used)
        force[1] += push
        return force


class YawDamping(Effect):
    """A moment against yawing: −c r/√(1 + (r/8 rad/s)²), c = `damping` in N m s/rad."""

    name = "yaw_damping"
    units: ClassVar = {"damping": "N m s/rad"}
    sizes = three(damping=(0.07, 0.2, 0.4))

    def body(self, now: Now, wrench: Array) -> Array:
        wrench[2] -= self.gate * self.p["damping"] * now.r / np.sqrt(1.0 + np.square(now.r / 8.0))
        return wrench


class RollDynamics(Effect):
    """The body rolls on its springs after a_y, and the load that it moves late costs grip: μ/(1 + q φ²).

    φ̈ = ω² (a_y/5 − φ) − 2 ζ ω φ̇ with ω = `frequency` in rad/s, ζ = 0.35; `loss` is the share lost at a steady 5 m/s².
    """

    name = "roll_dynamics"
    units: ClassVar = {"loss": "-", "frequency": "rad/s"}
    sizes = three(loss=(0.13, 0.35, 0.55), frequency=(16.0, 11.0, 8.0))
    DAMPING = 0.35

    def attach(self, plant: Plant) -> None:
        self.q = self.gate * self.p["loss"] / (1.0 - self.p["loss"])

    def n_states(self, n_wheels: int) -> int:
        return 2

    def grip(self, now: Now, friction: Array) -> Array:
        return friction / (1.0 + self.q * np.square(self.own(now)[0]))

    def rates(self, now: Now) -> Array:
        angle, speed = self.own(now)
        frequency = self.p["frequency"]
        swing = frequency * (frequency * (now.a_y / FULL_TURN - angle) - 2.0 * self.DAMPING * speed)
        return np.stack([speed, swing])


EFFECTS = (
    LongitudinalLoadTransfer,
    LateralLoadSensitivity,
    TyreRelaxation,
    FrictionFade,
    TyreHeating,
    SpeedDependentFriction,
    FrictionPatch,
    CamberThrust,
    YawDamping,
    RollDynamics,
)
