"""Flaws of the drive: between commanded and actual wheel speed, and between the axles."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

import numpy as np

from tests.gap.plant.effects.base import DelayLine, Effect, three
from tests.gap.plant.tyre import Array

if TYPE_CHECKING:
    from tests.gap.plant.car import Now, Plant


class DriveDelay(Effect):
    """ω_ref reaches the motor `delay` s late: a line of whole time steps."""

    name = "drive_delay"
    units: ClassVar = {"delay": "s"}
    sizes = three(delay=(0.013, 0.040, 0.080))

    def attach(self, plant: Plant) -> None:
        self.steps = np.rint(self.gate * self.p["delay"] / plant.dt).astype(int)
        self.line = DelayLine(int(self.steps.max()))

    def begin(self, now: Now, command: Array) -> None:
        self.line.fill(command[1])

    def command(self, now: Now, command: Array) -> Array:
        self.line.write(command[1])
        return np.stack([command[0], self.line.read(self.steps)])


class DriveBrakeAsymmetry(Effect):
    """Braking answers `ratio` times as slowly as driving: T = T_ω ratio^σ(−e/0.1 m/s), σ the logistic function."""

    name = "drive_brake_asymmetry"
    units: ClassVar = {"ratio": "-"}
    sizes = three(ratio=(1.35, 2.2, 3.5))

    def attach(self, plant: Plant) -> None:
        self.sharpness = plant.cars["drive_time"] / 0.1  # s per m/s, × rate in m/s² gives e/0.1
        self.log_ratio = np.log(self.p["ratio"])

    def motor(self, now: Now, rate: Array) -> Array:
        braking = 0.5 - 0.5 * np.tanh(0.5 * self.sharpness * rate)  # the logistic function of −e/0.1
        return self.pick(rate * np.exp(-self.log_ratio * braking), rate)


class CurrentLimit(Effect):
    """The motor's torque saturates: ω̇ = a tanh(ω̇₀/a), a = `acceleration` in m/s²."""

    name = "current_limit"
    units: ClassVar = {"acceleration": "m/s^2"}
    sizes = three(acceleration=(16.0, 6.5, 3.5))

    def motor(self, now: Now, rate: Array) -> Array:
        limit = self.p["acceleration"]
        return self.pick(limit * np.tanh(rate / limit), rate)


class DriveSaturation(Effect):
    """The wheels stop short of fast commands: (ω + ω_max − √((ω − ω_max)² + (0.1 m/s)²))/2, ω_max = `speed` in m/s."""

    name = "drive_saturation"
    units: ClassVar = {"speed": "m/s"}
    sizes = three(speed=(3.4, 2.6, 1.8))
    KNEE = 0.1  # m/s

    def command(self, now: Now, command: Array) -> Array:
        wanted, most = np.abs(command[1]), self.p["speed"]
        reached = 0.5 * (wanted + most - np.hypot(wanted - most, self.KNEE))
        return np.stack([command[0], self.pick(np.sign(command[1]) * reached, command[1])])


class BackEmf(Effect):
    """Speeding up fades towards the no-load speed: ω̇ ≤ a₀ (1 − (ω/ω₀)^1.5), reached softly (tanh); braking is free.

    a₀ = `acceleration` in m/s², ω₀ = `no_load_speed` in m/s.
    """

    name = "back_emf"
    units: ClassVar = {"acceleration": "m/s^2", "no_load_speed": "m/s"}
    sizes = three(acceleration=(25.0, 14.0, 9.0), no_load_speed=(8.0, 6.2, 5.2))

    def motor(self, now: Now, rate: Array) -> Array:
        speed = np.maximum(now.omega, 0.0) / self.p["no_load_speed"]
        limit = self.p["acceleration"] * np.maximum(1.0 - speed * np.sqrt(speed), 1e-3)
        return self.pick(np.where(rate > 0.0, limit * np.tanh(rate / limit), rate), rate)


class BatterySag(Effect):
    """The speed reached falls short of the command as the battery empties with the way driven.

    ω_ref (1 − s (1 − exp(−d/D))), d the way of the wheels in the whole log in m, s = `shortfall`, D = `distance` in m.
    """

    name = "battery_sag"
    units: ClassVar = {"shortfall": "-", "distance": "m"}
    sizes = three(shortfall=(0.04, 0.12, 0.24), distance=400.0)
    persists = True

    def n_states(self, n_wheels: int) -> int:
        return 1

    def command(self, now: Now, command: Array) -> Array:
        spent = -np.expm1(-self.own(now)[0] / self.p["distance"])
        return np.stack([command[0], command[1] * (1.0 - self.gate * self.p["shortfall"] * spent)])

    def rates(self, now: Now) -> Array:
        return np.abs(now.omega)[None]


class DriveLoadDroop(Effect):
    """The wheel speed gives way under load: ω settles at ω_ref − k F₀ sinh(F_x/F₀), F₀ = 25 N, k = `droop` in m/s/N."""

    name = "drive_load_droop"
    units: ClassVar = {"droop": "m/s/N"}
    sizes = three(droop=(0.004, 0.012, 0.024))
    KNEE = 25.0  # N

    def attach(self, plant: Plant) -> None:
        self.time = plant.cars["drive_time"]

    def motor(self, now: Now, rate: Array) -> Array:
        slack = self.p["droop"] * self.KNEE * np.sinh(now.force[0].sum(0) / self.KNEE)
        return rate - self.gate * slack / self.time


class RegenBraking(Effect):
    """The motor brakes as a generator when the command drops below the speed, the harder the faster it turns.

    ω̇ − b ω (1 − exp(−(ω − ω_ref)/0.3 m/s)) while ω > ω_ref, b = `braking` in 1/s.
    """

    name = "regen_braking"
    units: ClassVar = {"braking": "1/s"}
    sizes = three(braking=(2.5, 7.5, 15.0))

    def attach(self, plant: Plant) -> None:
        self.time = plant.cars["drive_time"]

    def motor(self, now: Now, rate: Array) -> Array:
        engaged = -np.expm1(np.minimum(rate * self.time, 0.0) / 0.3)
        return rate - self.gate * self.p["braking"] * now.omega * engaged


class DriveSplit(Effect):
    """A centre differential with a viscous coupling: ω is its mean speed, the axles turn at ω ± Δ.

    Δ̇ = g (share F_x,rear − (1 − share) F_x,front − c Δ), g = 1 kg⁻¹, c = 6 N s/m: where slip is small the front axle
    carries `front_share` of the force.
    """

    name = "drive_split"
    units: ClassVar = {"front_share": "-"}
    sizes = three(front_share=(0.30, 0.45, 0.65))
    MOBILITY, COUPLING = 1.0, 6.0  # 1/kg, N s/m

    def n_states(self, n_wheels: int) -> int:
        return 1

    def surface(self, now: Now, speed: Array) -> Array:
        spread = self.gate * self.own(now)[0]
        return np.concatenate([speed[: now.n_front] + spread, speed[now.n_front :] - spread])

    def rates(self, now: Now) -> Array:
        front, rear = now.force[0, : now.n_front].sum(0), now.force[0, now.n_front :].sum(0)
        share = self.p["front_share"]
        return self.MOBILITY * (share * rear - (1.0 - share) * front - self.COUPLING * self.own(now))


class LockedDifferential(Effect):
    """The two rear wheels turn as one, so in a turn the inner is driven and the outer braked.

    Each wheel is half an axle tyre at κ ± r t/(2|V_x|); M = −(t/4) (F_x(κ + Δκ) − F_x(κ − Δκ)), t = `track_width` in m.
    """

    name = "locked_differential"
    units: ClassVar = {"track_width": "m"}
    sizes = three(track_width=(0.10, 0.20, 0.30))

    def attach(self, plant: Plant) -> None:
        self.forces_of = plant.forces

    def body(self, now: Now, wrench: Array) -> Array:
        width = self.gate * self.p["track_width"]
        apart = np.zeros_like(now.slip)
        apart[0] = 0.5 * now.r * width / now.reference
        inner = self.forces_of(now.curves, now.slip + apart)[0, now.n_front :]
        outer = self.forces_of(now.curves, now.slip - apart)[0, now.n_front :]
        wrench[2] -= 0.25 * width * (inner - outer).sum(0)
        return wrench


EFFECTS = (
    DriveDelay,
    DriveBrakeAsymmetry,
    CurrentLimit,
    BackEmf,
    BatterySag,
    DriveLoadDroop,
    RegenBraking,
    DriveSplit,
    LockedDifferential,
)
LATER = (DriveSaturation,)
