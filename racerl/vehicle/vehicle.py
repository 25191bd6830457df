"""The single-track car: one derivative, written once over named scalars, executed by torch and CasADi.

Frames: world x, y; body x forward, y left, yaw counter-clockwise positive. Velocities are of the centre of gravity.

    ẋ = v_x cos ψ − v_y sin ψ            m (v̇_x − v_y r) = F_xf cos δ − F_yf sin δ + F_xr − F_drag
    ẏ = v_x sin ψ + v_y cos ψ            m (v̇_y + v_x r) = F_xf sin δ + F_yf cos δ + F_yr
    ψ̇ = r                                I_z ṙ = l_f (F_xf sin δ + F_yf cos δ) − l_r F_yr

Tyre forces come from the slips at each axle, driven by one wheel surface speed ω (the car has a locked four-wheel
drive): κ = (ω − V_x)/V, α* = −V_y/V with the wheel's velocity (V_x, V_y) in its own frame. V = |V_x| above the
standstill speed v_0; below, V = (V_x² + v_0²)/(2 v_0), once continuously differentiable, so nothing divides by zero.

Drag: F_drag = c_0 tanh(v_x/0.1) + c_1 v_x + c_2 v_x|v_x|.
"""

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

from racerl.errors import VehicleError
from racerl.vehicle.actuator import Actuator, Given, Instant
from racerl.vehicle.effects import Effect
from racerl.vehicle.ops import Ops, Scalar
from racerl.vehicle.parameter import parameter

GRAVITY = 9.81  # m/s²
STATE = ("x", "y", "yaw", "v_x", "v_y", "yaw_rate", "delta", "omega")
COMMAND = ("delta_ref", "drive_ref")


class Tyre(Protocol):
    """Forces of one axle from slips and load."""

    def forces(self, kappa: Scalar, alpha: Scalar, F_z: Scalar, friction: Scalar, ops: Ops) -> tuple[Scalar, Scalar]:
        """Return (F_x, F_y) in N in the wheel's frame."""


class Motion(NamedTuple):
    """What effects may look at: pose, velocities, road-wheel angle, wheel speed, the effects' own states, the car."""

    x: Scalar
    y: Scalar
    yaw: Scalar
    v_x: Scalar
    v_y: Scalar
    yaw_rate: Scalar
    delta: Scalar
    omega: Scalar
    own: Mapping[str, Scalar]
    car: "Vehicle"


class Slips(NamedTuple):
    """Slip ratio κ and α* = tan α of both axles."""

    kappa_f: Scalar
    alpha_f: Scalar
    kappa_r: Scalar
    alpha_r: Scalar


class Forces(NamedTuple):
    """Tyre forces of both axles in their wheels' frames, and their loads, in N."""

    F_xf: Scalar
    F_yf: Scalar
    F_xr: Scalar
    F_yr: Scalar
    F_zf: Scalar
    F_zr: Scalar


class Servo(NamedTuple):
    """An actuator at work: where it is, its state, its reference and the rate that it answers with."""

    position: Scalar
    state: Scalar
    reference: Scalar
    rate: Scalar


class Course(NamedTuple):
    """What effects' own states may follow: the motion, steady-state slips, tyre forces and both actuators."""

    motion: Motion
    steady: Slips
    forces: Forces
    steering: Servo
    drive: Servo


class Wrench(NamedTuple):
    """Force (N) and moment (N m) on the centre of gravity in the body frame."""

    F_x: Scalar
    F_y: Scalar
    M_z: Scalar


@dataclass(frozen=True, kw_only=True)
class Vehicle:
    """A car with its parameters; every parameter may hold one value per car.

    State tensors have the shape (S, N): one row per name in `states`, one column per car. Commands are (2, N): the
    steering reference in rad and the drive reference (wheel speed in m/s, or motor current in A).
    """

    mass: Scalar = parameter("kg", 0.1, 5000.0, "mass")
    yaw_inertia: Scalar = parameter("kg m²", 1e-4, 20000.0, "moment of inertia about the vertical axis")
    wheelbase: Scalar = parameter("m", 0.05, 10.0, "distance between the axles")
    l_f: Scalar = parameter("m", 0.01, 9.0, "distance of the centre of gravity from the front axle")
    friction: Scalar = parameter("", 0.05, 3.0, "friction scale λ_μ of both axles", 1.0)
    drag_constant: Scalar = parameter("N", 0.0, 500.0, "c_0 of the drag", 0.0)
    drag_linear: Scalar = parameter("N s/m", 0.0, 100.0, "c_1 of the drag", 0.0)
    drag_quadratic: Scalar = parameter("N s²/m²", 0.0, 10.0, "c_2 of the drag", 0.0)
    standstill_speed: Scalar = parameter("m/s", 0.05, 5.0, "v_0, below which slips are regularised", 0.5)
    front: Tyre
    rear: Tyre
    steering: Actuator
    drive: Actuator
    effects: Mapping[str, Effect] = field(default_factory=dict)
    body: str = ""  # of racerl.vehicle.bodies, driven in place of these equations

    @property
    def weight(self) -> Scalar:
        """Weight in N."""
        return self.mass * GRAVITY

    @property
    def arm(self) -> Scalar:
        """Distance of the centre of gravity from the front axle in m, with the effects that move it."""
        l_f = self.l_f
        for effect in self.effects.values():
            l_f = effect.arm(l_f)
        return l_f

    @property
    def l_r(self) -> Scalar:
        """Distance of the centre of gravity from the rear axle in m."""
        return self.wheelbase - self.arm

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the state's rows: the car's own, then those of its effects."""
        return STATE + tuple(f"{name}.{state}" for name, effect in self.effects.items() for state in effect.states)

    def without_actuators(self) -> "Vehicle":
        """Return this car with commands that act at once."""
        return dataclasses.replace(self, steering=Instant(), drive=Instant())

    def delays(self) -> dict[str, Scalar]:
        """Return by how many seconds each of COMMAND acts late, for those that do."""
        return _total(effect.delays() for effect in self.effects.values())

    def latencies(self) -> dict[str, Scalar]:
        """Return by how many seconds each channel of a log is late, for those that are."""
        return _total(effect.latencies() for effect in self.effects.values())

    def measured(self, channels: Mapping[str, Scalar], ops: Ops) -> dict[str, Scalar]:
        """Return what sensors show of true channels (rows of STATE by name), without noise and latency."""
        shown = dict(channels)
        for effect in self.effects.values():
            shown |= effect.measure(shown, ops)
        return shown

    def loads(self, motion: Motion, ops: Ops) -> tuple[Scalar, Scalar]:
        """Return the vertical loads (front, rear) in N."""
        weight = self.mass * (GRAVITY / self.wheelbase)
        F_z = (weight * self.l_r, weight * self.arm)
        for effect in self.effects.values():
            F_z = effect.loads(F_z, motion, ops)
        return F_z

    def motion(self, state: Sequence[Scalar]) -> Motion:
        """Return the motion in states (8, N) whose δ and ω act as they are, with effects at rest."""
        x, y, yaw, v_x, v_y, yaw_rate, delta, omega = state[: len(STATE)]
        own = dict.fromkeys(self.states[len(STATE) :], 0.0 * x)
        return Motion(x, y, yaw, v_x, v_y, yaw_rate, delta, omega, own, self)

    def slips(self, motion: Motion, ops: Ops) -> Slips:
        """Return the steady-state slips of both axles."""
        V_xf, V_yf = self.front_velocity(motion, ops)
        V_yr = motion.v_y - self.l_r * motion.yaw_rate
        V_f, V_r = self.slip_speed(V_xf, ops), self.slip_speed(motion.v_x, ops)
        return Slips((motion.omega - V_xf) / V_f, -V_yf / V_f, (motion.omega - motion.v_x) / V_r, -V_yr / V_r)

    def slips_seen(self, steady: Slips, motion: Motion, ops: Ops) -> Slips:
        """Return the slips that the tyres see, where `steady` are those of the steady state."""
        slips = steady
        for effect in self.effects.values():
            slips = effect.slip(slips, motion, ops)
        return slips

    def grip(self, motion: Motion, ops: Ops) -> tuple[Scalar, Scalar]:
        """Return the friction scales of both axles."""
        friction = (self.friction, self.friction)
        for effect in self.effects.values():
            friction = effect.grip(friction, motion, ops)
        return friction

    def front_velocity(self, motion: Motion, ops: Ops) -> tuple[Scalar, Scalar]:
        """Return the front axle's velocity along and across its wheels."""
        sin_delta, cos_delta = ops.sin(motion.delta), ops.cos(motion.delta)
        lateral = motion.v_y + self.arm * motion.yaw_rate
        return motion.v_x * cos_delta + lateral * sin_delta, lateral * cos_delta - motion.v_x * sin_delta

    def slip_speed(self, V_x: Scalar, ops: Ops) -> Scalar:
        """Return |V_x|, smoothly bounded below by v_0/2."""
        speed, v_0 = ops.abs(V_x), self.standstill_speed
        return ops.where(speed > v_0, speed, (V_x * V_x + v_0 * v_0) / (2.0 * v_0))

    def tyre_forces(self, slips: Slips, motion: Motion, ops: Ops) -> Forces:
        """Return what the tyres do at given slips."""
        friction, (F_zf, F_zr) = self.grip(motion, ops), self.loads(motion, ops)
        F_xf, F_yf = self.front.forces(slips.kappa_f, slips.alpha_f, F_zf, friction[0], ops)
        F_xr, F_yr = self.rear.forces(slips.kappa_r, slips.alpha_r, F_zr, friction[1], ops)
        forces = Forces(F_xf, F_yf, F_xr, F_yr, F_zf, F_zr)
        for effect in self.effects.values():
            forces = effect.tyre(forces, slips, motion, ops)
        return forces

    def tyre_wrench(self, forces: Forces, motion: Motion, ops: Ops) -> Wrench:
        """Return what the tyres do to the body."""
        F_xf, F_yf, F_xr, F_yr, _, _ = forces
        sin_delta, cos_delta = ops.sin(motion.delta), ops.cos(motion.delta)
        lateral_f = F_xf * sin_delta + F_yf * cos_delta
        return Wrench(
            F_xf * cos_delta - F_yf * sin_delta + F_xr, lateral_f + F_yr, self.arm * lateral_f - self.l_r * F_yr
        )

    def wrench(self, forces: Forces, motion: Motion, ops: Ops) -> Wrench:
        """Return what tyres, drag and effects do to the body."""
        wrench = self.tyre_wrench(forces, motion, ops)
        wrench = wrench._replace(F_x=wrench.F_x - self.drag(motion.v_x, ops))
        for effect in self.effects.values():
            wrench = effect.wrench(wrench, forces, motion, ops)
        return wrench

    def drag(self, v_x: Scalar, ops: Ops) -> Scalar:
        """Return the drag in N, of the sign of v_x."""
        steady = self.drag_linear * v_x + self.drag_quadratic * v_x * ops.abs(v_x)
        return steady + self.drag_constant * ops.tanh(v_x * 10.0)

    def derivative(self, state: Any, command: Any, ops: Ops) -> Any:
        """Return d(state)/dt for stacked state (S, N) and command (2, N); raise VehicleError for a foreign body."""
        if self.body:
            raise VehicleError(
                f"vehicle.body = {self.body}: such a car can be recorded and raced in (car={self.body}), "
                "not fitted, optimised or predicted; leave body out"
            )
        x, y, yaw, v_x, v_y, yaw_rate, delta, omega, *rest = ops.unstack(state)
        own = dict(zip(self.states[len(STATE) :], rest, strict=True))
        delta_ref, drive_ref = ops.unstack(command)
        for effect in self.effects.values():
            commands = effect.command(delta_ref, drive_ref, own, ops)
            delta_ref = delta_ref if isinstance(self.steering, Given) else commands[0]
            drive_ref = drive_ref if isinstance(self.drive, Given) else commands[1]
        wheel_angle = servo_angle = self.steering.position(delta, delta_ref)
        for effect in self.effects.values():
            wheel_angle = effect.link(wheel_angle, own, ops)
        for effect in self.effects.values():
            wheel_angle = effect.steer(wheel_angle, own, ops)
        wheel_speed = self.drive.position(omega, drive_ref)
        motion = Motion(x, y, yaw, v_x, v_y, yaw_rate, wheel_angle, wheel_speed, own, self)

        steady = self.slips(motion, ops)
        slips = self.slips_seen(steady, motion, ops)
        forces = self.tyre_forces(slips, motion, ops)
        wrench = self.wrench(forces, motion, ops)
        traction = forces.F_xf + forces.F_xr
        steering = Servo(servo_angle, delta, delta_ref, self.steering.rate(delta, delta_ref, traction, ops))
        drive = Servo(wheel_speed, omega, drive_ref, self.drive.rate(omega, drive_ref, traction, ops))
        course = Course(motion, steady, forces, steering, drive)
        steering_rate, drive_rate = steering.rate, drive.rate
        for effect in self.effects.values():
            steering_rate = effect.steering_rate(steering_rate, course, ops)
            drive_rate = effect.drive_rate(drive_rate, course, ops)

        sin_yaw, cos_yaw = ops.sin(yaw), ops.cos(yaw)
        return ops.stack(
            [
                v_x * cos_yaw - v_y * sin_yaw,
                v_x * sin_yaw + v_y * cos_yaw,
                yaw_rate,
                wrench.F_x / self.mass + v_y * yaw_rate,
                wrench.F_y / self.mass - v_x * yaw_rate,
                wrench.M_z / self.yaw_inertia,
                steering_rate,
                drive_rate,
                *(rate for effect in self.effects.values() for rate in effect.rates(course, ops)),
            ]
        )


def _total(parts: Iterable[Mapping[str, Scalar]]) -> dict[str, Scalar]:
    total: dict[str, Scalar] = {}
    for part in parts:
        for name, value in part.items():
            total[name] = total[name] + value if name in total else value
    return total
