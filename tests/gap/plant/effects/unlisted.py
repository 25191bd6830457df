"""Effects that no catalogue lists: the right verdict on them is "unknown"."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

import numpy as np

from tests.gap.plant.effects.base import Effect, three
from tests.gap.plant.tyre import Array

if TYPE_CHECKING:
    from tests.gap.plant.car import Now, Plant


class WheelCogging(Effect):
    """Wheels out of round: the surface speed ripples by `ripple` with a wave length of 0.35 m of their way."""

    name = "wheel_cogging"
    units: ClassVar = {"ripple": "-", "wave_length": "m"}
    sizes = three(ripple=(0.04, 0.12, 0.25), wave_length=0.35)

    def n_states(self, n_wheels: int) -> int:
        return 1

    def surface(self, now: Now, speed: Array) -> Array:
        phase = 2 * np.pi * self.own(now)[0] / self.p["wave_length"]
        return speed * (1.0 + self.gate * self.p["ripple"] * np.sin(phase))

    def rates(self, now: Now) -> Array:
        return now.omega[None]


class WindGust(Effect):
    """A fan across the hall: a force in the world's direction 2.1 rad that swells with periods of 7.3 s and 2.9 s."""

    name = "wind_gust"
    units: ClassVar = {"force": "N"}
    sizes = three(force=(1.0, 3.0, 6.0))
    DIRECTION = 2.1  # rad

    def body(self, now: Now, wrench: Array) -> Array:
        swell = 0.65 * np.sin(2 * np.pi * now.t / 7.3) + 0.35 * np.sin(2 * np.pi * now.t / 2.9 + 1.0)
        force = self.gate * self.p["force"] * swell
        east, north = force * np.cos(self.DIRECTION), force * np.sin(self.DIRECTION)
        wrench[0] += now.cos_yaw * east + now.sin_yaw * north
        wrench[1] += now.cos_yaw * north - now.sin_yaw * east
        return wrench


class ServoUnderLoad(Effect):
    """The front's side force slows the servo: δ̇/(1 + k (F_y/8 N)²), k = `slowing`."""

    name = "servo_under_load"
    units: ClassVar = {"slowing": "-"}
    sizes = three(slowing=(0.7, 2.0, 5.0))

    def servo(self, now: Now, rate: Array) -> Array:
        load = now.force[1, : now.n_front].sum(0) / 8.0
        return rate / (1.0 + self.gate * self.p["slowing"] * load * load)


class ReversalStiffening(Effect):
    """A carcass with hysteresis: side forces × 1 + k exp(−d/0.6 m), d the way since the steering last turned back.

    k = `gain`.
    """

    name = "reversal_stiffening"
    units: ClassVar = {"gain": "-"}
    sizes = three(gain=(0.12, 0.35, 0.7))

    def begin(self, now: Now, command: Array) -> None:
        self.heading = np.zeros(self.on.shape)
        self.way = np.full(self.on.shape, 10.0)  # m
        self.extreme = now.state[6].copy()

    def tick(self, now: Now) -> None:
        moved = now.delta - self.extreme
        turned = np.where(np.abs(moved) > 0.01, np.sign(moved), self.heading)
        self.way = np.where(turned != self.heading, 0.0, self.way + np.abs(now.v_x) * self.dt)
        self.extreme = np.where((moved * turned > 0) | (turned != self.heading), now.delta, self.extreme)
        self.heading = turned

    def forces(self, now: Now, force: Array) -> Array:
        force[1] *= 1.0 + self.gate * self.p["gain"] * np.exp(-self.way / 0.6)
        return force


class FlutteringTyre(Effect):
    """A torn right rear tyre catches the ground near 2.5 m/s: a drag F exp(−((v − 2.5)/0.4)²), 0.1 m off centre."""

    name = "fluttering_tyre"
    units: ClassVar = {"drag": "N"}
    sizes = three(drag=(2.0, 6.0, 12.0))

    def body(self, now: Now, wrench: Array) -> Array:
        drag = self.gate * self.p["drag"] * np.exp(-np.square((now.v_x - 2.5) / 0.4))
        wrench[0] -= drag
        wrench[2] -= 0.1 * drag
        return wrench


class CasterSelfSteer(Effect):
    """The casters swing out as the car turns: the road wheel turns on by k r|r|, k = `gain` in rad/(rad/s)²."""

    name = "caster_self_steer"
    units: ClassVar = {"gain": "s^2/rad"}
    sizes = three(gain=(0.004, 0.012, 0.022))

    def road_wheel(self, now: Now, angle: Array) -> Array:
        return angle - self.gate * self.p["gain"] * now.r * np.abs(now.r)


class FloorSeams(Effect):
    """Raised seams across the hall every 1.5 m of x unload a wheel that crosses one by `unloading` of its load."""

    name = "floor_seams"
    units: ClassVar = {"unloading": "-"}
    sizes = three(unloading=(0.25, 0.7, 0.95))
    SPACING, WIDTH = 1.5, 0.15  # m

    def attach(self, plant: Plant) -> None:
        self.X, self.Y = plant.wheels.X, plant.wheels.Y

    def loads(self, now: Now, load: Array) -> Array:
        place = now.x + now.cos_yaw * self.X - now.sin_yaw * self.Y
        off = np.mod(place, self.SPACING) - 0.5 * self.SPACING
        return load * (1.0 - self.gate * self.p["unloading"] * np.exp(-np.square(off / self.WIDTH)))


class LooseLoad(Effect):
    """A battery of `mass` kg swings sideways on its straps at 2.2 Hz, 5 cm behind the CoG, and pulls the body along.

    ÿ = −a_y − ω² y − 2 ζ ω ẏ with ζ = 0.08; the body feels m (ω² y + 2 ζ ω ẏ).
    """

    name = "loose_load"
    units: ClassVar = {"mass": "kg"}
    sizes = three(mass=(0.25, 0.7, 1.3))
    FREQUENCY, DAMPING, BEHIND = 2 * np.pi * 2.2, 0.08, 0.05

    def n_states(self, n_wheels: int) -> int:
        return 2

    def body(self, now: Now, wrench: Array) -> Array:
        pull = self.gate * self.p["mass"] * self._strap(now)
        wrench[1] += pull
        wrench[2] -= self.BEHIND * pull
        return wrench

    def rates(self, now: Now) -> Array:
        return np.stack([self.own(now)[1], -now.a_y - self._strap(now)])

    def _strap(self, now: Now) -> Array:
        place, speed = self.own(now)
        return self.FREQUENCY * (self.FREQUENCY * place + 2.0 * self.DAMPING * speed)


EFFECTS = (
    WheelCogging,
    WindGust,
    ServoUnderLoad,
    ReversalStiffening,
    FlutteringTyre,
    CasterSelfSteer,
    FloorSeams,
    LooseLoad,
)
