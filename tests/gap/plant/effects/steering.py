"""Flaws of the steering: between command and measured angle, and between measured angle and road wheel."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

import numpy as np

from tests.gap.plant.effects.base import DelayLine, Effect, three
from tests.gap.plant.tyre import Array

if TYPE_CHECKING:
    from tests.gap.plant.car import Now, Plant


class SteeringDelay(Effect):
    """δ_ref reaches the servo `delay` s late: a line of whole time steps."""

    name = "steering_delay"
    units: ClassVar = {"delay": "s"}
    sizes = three(delay=(0.013, 0.040, 0.080))

    def attach(self, plant: Plant) -> None:
        self.steps = np.rint(self.gate * self.p["delay"] / plant.dt).astype(int)
        self.line = DelayLine(int(self.steps.max()))

    def begin(self, now: Now, command: Array) -> None:
        self.line.fill(command[0])

    def command(self, now: Now, command: Array) -> Array:
        self.line.write(command[0])
        return np.stack([self.line.read(self.steps), command[1]])


class SteeringSecondOrder(Effect):
    """A servo with inertia and a soft torque limit: δ̈ = ω_n² A tanh((δ_ref − δ)/A) − 2 ζ ω_n δ̇, A = 0.4 rad."""

    name = "steering_second_order"
    units: ClassVar = {"natural_frequency": "rad/s", "damping": "-"}
    sizes = three(natural_frequency=(45.0, 27.0, 18.0), damping=(1.0, 0.6, 0.45))
    SOFTNESS = 0.4  # rad

    def n_states(self, n_wheels: int) -> int:
        return 1

    def servo(self, now: Now, rate: Array) -> Array:
        return self.pick(self.own(now)[0], rate)

    def rates(self, now: Now) -> Array:
        frequency, damping = self.p["natural_frequency"], self.p["damping"]
        torque = self.SOFTNESS * np.tanh((now.command[0] - now.delta) / self.SOFTNESS)
        return frequency * (frequency * torque - 2.0 * damping * self.own(now))


class SteeringRateLimit(Effect):
    """The servo's speed ends at `rate` rad/s, hard."""

    name = "steering_rate_limit"
    units: ClassVar = {"rate": "rad/s"}
    sizes = three(rate=(4.8, 2.8, 1.5))

    def servo(self, now: Now, rate: Array) -> Array:
        return self.pick(np.clip(rate, -self.p["rate"], self.p["rate"]), rate)


class SteeringBacklash(Effect):
    """Play between servo and road wheel: a play operator of width `play` rad, the wheel resting where it was left."""

    name = "steering_backlash"
    units: ClassVar = {"play": "rad"}
    sizes = three(play=(0.013, 0.040, 0.080))

    def begin(self, now: Now, command: Array) -> None:
        self.link = now.state[6].copy()

    def tick(self, now: Now) -> None:
        self.link = self._pushed(now.delta)

    def road_wheel(self, now: Now, angle: Array) -> Array:
        return self.pick(angle + self._pushed(now.delta) - now.delta, angle)

    def _pushed(self, delta: Array) -> Array:
        half = 0.5 * self.p["play"]
        return np.clip(self.link, delta - half, delta + half)


class SteeringDeadband(Effect):
    """Dry friction in the servo: it breaks loose when |e| > `band` rad and sticks again below 0.6 band.

    While it moves, kinetic friction takes 0.6 band off the error: δ̇ = (e − 0.6 band sgn e)/T_δ.
    """

    name = "steering_deadband"
    units: ClassVar = {"band": "rad"}
    sizes = three(band=(0.012, 0.035, 0.070))
    KINETIC = 0.6

    def attach(self, plant: Plant) -> None:
        self.time = plant.cars["steering_time"]
        self.kinetic = self.KINETIC * self.p["band"]

    def begin(self, now: Now, command: Array) -> None:
        self.moving = np.zeros(self.on.shape, bool)

    def tick(self, now: Now) -> None:
        error = np.abs(now.command[0] - now.delta)
        self.moving = (error > self.p["band"]) | (self.moving & (error > self.kinetic))

    def servo(self, now: Now, rate: Array) -> Array:
        slowed = np.sign(rate) * np.maximum(np.abs(rate) - self.kinetic / self.time, 0.0)
        return self.pick(self.moving * slowed, rate)


class SteeringOffset(Effect):
    """A bent linkage: the road wheel stands `offset` rad left of the measured angle."""

    name = "steering_offset"
    units: ClassVar = {"offset": "rad"}
    sizes = three(offset=(0.010, 0.030, 0.060))
    signed = ("offset",)

    def road_wheel(self, now: Now, angle: Array) -> Array:
        return angle + self.gate * self.p["offset"]


class SteeringGainAsymmetry(Effect):
    """The linkage turns further to one side: angle × (1 + a tanh(angle/0.05 rad)), so left 1 + a and right 1 − a."""

    name = "steering_gain_asymmetry"
    units: ClassVar = {"asymmetry": "-"}
    sizes = three(asymmetry=(0.03, 0.09, 0.18))
    signed = ("asymmetry",)

    def road_wheel(self, now: Now, angle: Array) -> Array:
        return self.pick(angle * (1.0 + self.p["asymmetry"] * np.tanh(angle / 0.05)), angle)


class SteeringNonlinearity(Effect):
    """A progressive (c > 0) or degressive (c < 0) linkage: sinh(pδ)/p or asinh(pδ)/p ≈ δ + cδ³ with p = √(6|c|).

    c = `cubic` in 1/rad².
    """

    name = "steering_nonlinearity"
    units: ClassVar = {"cubic": "1/rad^2"}
    sizes = three(cubic=(0.4, 1.2, 2.4))
    signed = ("cubic",)

    def road_wheel(self, now: Now, angle: Array) -> Array:
        scale = np.sqrt(6.0 * np.abs(self.p["cubic"]))
        bent = np.where(self.p["cubic"] > 0, np.sinh(scale * angle), np.arcsinh(scale * angle)) / scale
        return self.pick(bent, angle)


class SteeringGain(Effect):
    """The road wheel turns by 1 + `excess` of the measured angle."""

    name = "steering_gain"
    units: ClassVar = {"excess": "-"}
    sizes = three(excess=(0.04, 0.12, 0.22))
    signed = ("excess",)

    def road_wheel(self, now: Now, angle: Array) -> Array:
        return angle * (1.0 + self.gate * self.p["excess"])


class SteeringSaturation(Effect):
    """The road wheel runs into its stop with a short knee: δ/(1 + |δ/δ_max|⁶)^(1/6), δ_max = `limit` rad."""

    name = "steering_saturation"
    units: ClassVar = {"limit": "rad"}
    sizes = three(limit=(0.30, 0.23, 0.16))

    def road_wheel(self, now: Now, angle: Array) -> Array:
        squared = np.square(angle / self.p["limit"])
        return self.pick(angle / np.power(1.0 + squared * squared * squared, 1 / 6), angle)


class SteeringCompliance(Effect):
    """The side force bends the linkage back through a hardening spring that yields within 8 ms.

    angle − z,  ż = (C F/√(1 + (F/25 N)²) − z)/8 ms, F the front axle's side force in N, C = `compliance` in rad/N.
    """

    name = "steering_compliance"
    units: ClassVar = {"compliance": "rad/N"}
    sizes = three(compliance=(0.0015, 0.0045, 0.009))
    LAG, YIELD = 0.008, 25.0  # s, N

    def n_states(self, n_wheels: int) -> int:
        return 1

    def road_wheel(self, now: Now, angle: Array) -> Array:
        return angle - self.gate * self.own(now)[0]

    def rates(self, now: Now) -> Array:
        force = now.force[1, : now.n_front].sum(0)
        twist = self.p["compliance"] * force / np.sqrt(1.0 + np.square(force / self.YIELD))
        return (twist - self.own(now)) / self.LAG


EFFECTS = (
    SteeringDelay,
    SteeringSecondOrder,
    SteeringRateLimit,
    SteeringBacklash,
    SteeringDeadband,
    SteeringOffset,
    SteeringGainAsymmetry,
    SteeringNonlinearity,
    SteeringGain,
    SteeringSaturation,
    SteeringCompliance,
)
