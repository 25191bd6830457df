"""The hidden car: a rigid body on two or four wheels, many cars at once, by Heun's method.

m (v̇_x − r v_y) = Σ F_x,   m (v̇_y + r v_x) = Σ F_y,   I_z ṙ = Σ (X_i F_y,i − Y_i F_x,i)
drag: −c₀ tanh(v_x/0.1) − c₁ v_x − c₂ v_x|v_x|;   δ̇ = (δ_ref − δ)/T_δ,   ω̇ = (ω_ref − ω)/T_ω
State rows: x, y, yaw, v_x, v_y, r, δ, ω, then those of structure and effects. One ω drives all wheels (locked
four-wheel drive) as a surface speed in m/s.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from tests.gap.plant import tyre
from tests.gap.plant.effects.base import GRAVITY, STEP, Effect
from tests.gap.plant.families import MAGIC_FORMULA, forces_of
from tests.gap.plant.tyre import Array, Curves, Tyre

TRACK_WIDTH = 0.2  # m, of cars with two wheels on an axle
COG_HEIGHT: dict[str, float] = {"four_wheels": 0.0, "ackermann": 0.0, "two_track": 0.07}  # m, of the same
ON_ONE_CIRCLE = "ackermann"  # of those, front wheels steer each by its own angle
STRUCTURES = ("single_track", *COG_HEIGHT)
N_BODY = 8  # rows of the state that every car has
HOOKS = (
    "tick", "command", "road_wheel", "surface", "loads", "grip", "forces", "body", "servo", "motor", "rates",
)  # fmt: skip

SLIPS: dict[str, Callable[[Array, Array], Array]] = {
    "centre": lambda V_x, omega: V_x,
    "surface": lambda V_x, omega: np.broadcast_to(omega, V_x.shape),
    "larger": lambda V_x, omega: np.maximum(np.abs(V_x), np.abs(omega)),
}

Lean = Callable[[Array, Array], Array]


def flat(x: Array, y: Array) -> Array:
    """Ground that leans nowhere: the world's direction to which it leans at each (x, y), (2, B)."""
    return np.zeros((2, len(x)))


@dataclass(frozen=True)
class Wheels:
    """Where the wheels are, and what they carry at rest; front wheels first."""

    X: Array  # m ahead of the CoG, (W, B)
    Y: Array  # m left of the CoG, (W, B)
    load: Array  # N, (W, B)
    tyre: Tyre
    n_front: int


def wheels_of(cars: dict[str, Array], per_axle: int) -> Wheels:
    """One wheel per axle on the centre line, or two a track width apart, each with its share of the axle's tyre."""
    l_f, wheelbase = cars["l_f"], cars["wheelbase"]
    weight = cars["mass"] * GRAVITY / per_axle
    side = np.array([0.5, -0.5] if per_axle == 2 else [0.0]) * TRACK_WIDTH
    return Wheels(
        X=np.repeat([l_f, l_f - wheelbase], per_axle, axis=0),
        Y=np.concatenate([side, side])[:, None] + cars["centre_line"],
        load=np.repeat([weight * (1 - l_f / wheelbase), weight * l_f / wheelbase], per_axle, axis=0),
        tyre=Tyre(_coefficients(cars, per_axle)),
        n_front=per_axle,
    )


def _coefficients(cars: dict[str, Array], per_axle: int) -> dict[str, Array]:
    """The tyres' coefficients by wheel, (W, B)."""
    names = [name.removeprefix("front.") for name in cars if name.startswith("front.")]
    by_wheel = {k: np.repeat([cars[f"front.{k}"], cars[f"rear.{k}"]], per_axle, axis=0) for k in names}
    return by_wheel | {"F_z0": by_wheel["F_z0"] / per_axle}


class FourWheelLoads(Effect):
    """Four wheels' own: their loads follow a_x and a_y within 20 ms, and open differentials on both axles."""

    name = "two_track"
    LAG = 0.02  # s

    def attach(self, plant: Plant) -> None:
        cars, wheels = plant.cars, plant.wheels
        self.Y = wheels.Y
        transfer = cars["mass"] * COG_HEIGHT[plant.structure] / 2
        self.pitch = np.array([-1.0, -1.0, 1.0, 1.0])[:, None] * transfer / cars["wheelbase"]
        share = np.repeat([1 - cars["l_f"] / cars["wheelbase"], cars["l_f"] / cars["wheelbase"]], 2, axis=0)
        self.roll = np.array([-1.0, 1.0, -1.0, 1.0])[:, None] * 2 * share * transfer / TRACK_WIDTH

    def n_states(self, n_wheels: int) -> int:
        return 2

    def loads(self, now: Now, load: Array) -> Array:
        a_x, a_y = self.own(now)
        return load + self.pitch * a_x + self.roll * a_y

    def surface(self, now: Now, speed: Array) -> Array:
        return speed - now.r * self.Y

    def rates(self, now: Now) -> Array:
        return (np.stack([now.a_x, now.a_y]) - self.own(now)) / self.LAG


class Now:
    """What an effect may look at: time, state and command, and what has been worked out so far in this evaluation."""

    t: float  # s, since the log began
    state: Array  # all rows, (n, B)
    command: Array  # δ_ref, ω_ref as they reach the actuators, (2, B)
    n_front: int
    x: Array
    y: Array
    yaw: Array
    v_x: Array
    v_y: Array
    r: Array
    delta: Array
    omega: Array
    cos_yaw: Array
    sin_yaw: Array
    V_x: Array  # m/s, the wheels' velocity in their own frames, (W, B)
    V_y: Array
    reference: Array  # m/s, |V_x| smoothed, (W, B)
    slip: Array  # κ and α*, (2, W, B)
    load: Array  # N, (W, B)
    friction: Array  # (W, B)
    curves: Curves
    force: Array  # N, in the wheels' frames, (2, W, B)
    a_x: Array  # m/s², force over mass in the car's frame, (B,)
    a_y: Array

    def see(self, t: float, state: Array) -> None:
        """Look at this time and state."""
        self.t, self.state = t, state
        self.x, self.y, self.yaw, self.v_x, self.v_y, self.r, self.delta, self.omega = state[:N_BODY]
        self.cos_yaw, self.sin_yaw = np.cos(self.yaw), np.sin(self.yaw)


class Plant:
    """B cars with their effects, driven by `advance`.

    `structure` is one of `STRUCTURES`, of which the two_track car's loads alone change; `family` is that of the tyres,
    `slip` the speed that slips are over: of the wheel's centre, of its surface, or the larger one. `dt` is in s.
    """

    def __init__(
        self,
        cars: dict[str, Array],
        effects: Sequence[Effect] = (),
        structure: str = "single_track",
        lean: Lean = flat,
        dt: float = STEP,
        family: str = MAGIC_FORMULA,
        slip: str = "centre",
    ) -> None:
        if structure not in STRUCTURES:
            raise ValueError(f"no structure {structure!r}; known: {', '.join(STRUCTURES)}")
        self.structure = structure
        self.dt, self.lean, self.slip = dt, lean, SLIPS[slip]
        self.forces = forces_of(family)
        self.n_cars = len(cars["mass"])
        self.cars = dict(cars) | {"centre_line": np.zeros(self.n_cars)}
        for effect in effects:
            effect.reshape(self.cars)
        self.wheels = wheels_of(self.cars, per_axle=1 + (structure in COG_HEIGHT))
        own = [FourWheelLoads(np.ones(self.n_cars), {})] if structure in COG_HEIGHT else []
        self._attach([*own, *effects])
        self._prepare()

    def _attach(self, effects: list[Effect]) -> None:
        """Give every effect its rows of the state, and collect who changes what."""
        n_rows, self.effects = N_BODY, effects
        for effect in effects:
            count = effect.n_states(len(self.wheels.X))
            effect.rows, effect.dt = slice(n_rows, n_rows + count), self.dt
            n_rows += count
            effect.attach(self)
        self.state = np.zeros((n_rows, self.n_cars))
        self.hooks = {h: [e for e in effects if getattr(type(e), h) is not getattr(Effect, h)] for h in HOOKS}

    def _prepare(self) -> None:
        """Work out what never changes."""
        cars, wheels, now = self.cars, self.wheels, Now()
        self.now = now
        now.n_front, now.command = wheels.n_front, np.zeros((2, self.n_cars))
        self.cos, self.sin = np.ones_like(wheels.X), np.zeros_like(wheels.X)
        self.has_width = bool(wheels.Y.any())
        self.friction = np.broadcast_to(cars["friction"], wheels.X.shape)
        self.changes_grip = bool(self.hooks["loads"] or self.hooks["grip"])
        now.load, now.friction = wheels.load, self.friction
        now.curves = wheels.tyre.curves(wheels.load, self.friction)

    def place(self, pose: Array, speed: Array, t: float) -> None:
        """Put the cars down at the poses (3, B) rolling straight at `speed` in m/s; effects that persist do."""
        for effect in self.effects:
            if not effect.persists:
                self.state[effect.rows] = 0.0
        self.state[:N_BODY] = 0.0
        self.state[:3], self.state[3], self.state[7] = pose, speed, speed
        self.t = t

    def begin(self, command: Array) -> None:
        """Reset all memory as though this command had been held for long."""
        self.now.see(self.t, self.state)
        for effect in self.effects:
            effect.begin(self.now, command)

    def rest(self, seconds: float) -> None:
        """Let the cars stand between two runs."""
        for effect in self.effects:
            effect.rest(self.state[effect.rows], seconds)

    def advance(self, command: Array) -> None:
        """One time step of Heun's method under δ_ref and ω_ref, (2, B)."""
        now, dt = self.now, self.dt
        now.see(self.t, self.state)
        for effect in self.hooks["command"]:
            command = effect.command(now, command)
        now.command = command
        for effect in self.hooks["tick"]:
            effect.tick(now)
        first = self.derivative(self.t, self.state)
        second = self.derivative(self.t + dt, self.state + dt * first)
        first += second
        first *= 0.5 * dt
        self.state = self.state + first
        self.t += dt

    def derivative(self, t: float, state: Array) -> Array:
        """The state's rate of change, (n, B)."""
        now = self.now
        now.see(t, state)
        self._roll(now)
        if self.changes_grip:
            self._load(now)
        force = self.forces(now.curves, now.slip)
        for effect in self.hooks["forces"]:
            force = effect.forces(now, force)
        now.force = force
        return self._rates(now, self._wrench(now))

    def _roll(self, now: Now) -> None:
        """Steer the wheels and work out their slips."""
        angle, n = now.delta, now.n_front
        for effect in self.hooks["road_wheel"]:
            angle = effect.road_wheel(now, angle)
        if self.structure == ON_ONE_CIRCLE:  # about a point in line with the rear axle
            tan = np.tan(angle)
            Y = self.wheels.Y[:n] - self.wheels.Y[:n].mean(axis=0)
            angle = np.arctan(tan / (1.0 - Y * tan / self.cars["wheelbase"]))
        cos, sin = self.cos, self.sin
        cos[:n], sin[:n] = np.cos(angle), np.sin(angle)
        ahead = now.v_x - now.r * self.wheels.Y if self.has_width else now.v_x
        aside = now.v_y + now.r * self.wheels.X
        now.V_x = ahead * cos + aside * sin
        now.V_y = aside * cos - ahead * sin
        speed = now.omega
        if self.hooks["surface"]:
            speed = np.broadcast_to(speed, cos.shape)
            for effect in self.hooks["surface"]:
                speed = effect.surface(now, speed)
        now.reference = tyre.slip_speed(self.slip(now.V_x, speed))
        slip = np.empty((2, *cos.shape))
        slip[0], slip[1] = speed - now.V_x, -now.V_y
        slip /= now.reference
        now.slip = slip

    def _load(self, now: Now) -> None:
        """Loads, friction and the tyre curves that follow from them."""
        load, friction = self.wheels.load, self.friction
        for effect in self.hooks["loads"]:
            load = effect.loads(now, load)
        for effect in self.hooks["grip"]:
            friction = effect.grip(now, friction)
        now.load, now.friction = np.maximum(load, tyre.LEAST_LOAD), friction
        now.curves = self.wheels.tyre.curves(now.load, friction)

    def _wrench(self, now: Now) -> Array:
        """F_x, F_y and M_z on the body in the car's frame, (3, B)."""
        cars, (F_x, F_y) = self.cars, now.force
        ahead = F_x * self.cos - F_y * self.sin
        aside = F_x * self.sin + F_y * self.cos
        moment = self.wheels.X * aside
        if self.has_width:
            moment -= self.wheels.Y * ahead
        v_x = now.v_x
        drag = cars["drag_constant"] * np.tanh(v_x / 0.1)
        drag += v_x * (cars["drag_linear"] + cars["drag_quadratic"] * np.abs(v_x))
        wrench: Array = np.empty((3, self.n_cars))
        wrench[0] = np.add.reduce(ahead) - drag
        wrench[1] = np.add.reduce(aside)
        wrench[2] = np.add.reduce(moment)
        for effect in self.hooks["body"]:
            wrench = effect.body(now, wrench)
        return wrench

    def _rates(self, now: Now, wrench: Array) -> Array:
        """Rates of body, actuators and the effects' own states."""
        cars = self.cars
        now.a_x, now.a_y = wrench[:2] / cars["mass"]
        servo = (now.command[0] - now.delta) / cars["steering_time"]
        for effect in self.hooks["servo"]:
            servo = effect.servo(now, servo)
        motor = (now.command[1] - now.omega) / cars["drive_time"]
        for effect in self.hooks["motor"]:
            motor = effect.motor(now, motor)
        rates = np.empty_like(now.state)
        rates[0] = now.cos_yaw * now.v_x - now.sin_yaw * now.v_y
        rates[1] = now.sin_yaw * now.v_x + now.cos_yaw * now.v_y
        rates[2] = now.r
        rates[3] = now.a_x + now.r * now.v_y
        rates[4] = now.a_y - now.r * now.v_x
        rates[5] = wrench[2] / cars["yaw_inertia"]
        rates[6], rates[7] = servo, motor
        for effect in self.hooks["rates"]:
            rates[effect.rows] = effect.rates(now)
        return rates
