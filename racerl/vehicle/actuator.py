"""Actuators: how a command becomes a steering angle or a wheel speed.

`FirstOrder`    ẋ = (x_ref − x)/T, the paper's steering and wheel-speed control.
`Instant`       x = x_ref, the paper's ablation without an actuator model.
`Given`         x as it was measured: what a log says drives the car, whatever was commanded.
`MotorCurrent`  the drive of a human driver: current → torque → wheel force. With ω the wheel surface speed,
                m_rot ω̇ = k·i·η/R·I − ΣF_x, where m_rot = J/R² is the inertia of motor, gear and wheels at the tyre.

Each answers with the position that acts on the car now and the rate of its state.
"""

from dataclasses import dataclass
from typing import Protocol

from racerl.vehicle.ops import Ops, Scalar
from racerl.vehicle.parameter import parameter


class Actuator(Protocol):
    """A state that follows a reference; `traction` is the sum of longitudinal tyre forces in N."""

    def position(self, state: Scalar, reference: Scalar) -> Scalar:
        """Return what acts on the car now."""

    def rate(self, state: Scalar, reference: Scalar, traction: Scalar, ops: Ops) -> Scalar:
        """Return the time derivative of the state."""


@dataclass(frozen=True, kw_only=True)
class FirstOrder:
    """ẋ = (x_ref − x)/T."""

    time_constant: Scalar = parameter("s", 0.002, 2.0, "time to cover 63 % of a step")

    def position(self, state: Scalar, reference: Scalar) -> Scalar:
        """Return the state itself."""
        return state

    def rate(self, state: Scalar, reference: Scalar, traction: Scalar, ops: Ops) -> Scalar:
        """Return (x_ref − x)/T."""
        return (reference - state) / self.time_constant


@dataclass(frozen=True)
class Instant:
    """x = x_ref at once."""

    def position(self, state: Scalar, reference: Scalar) -> Scalar:
        """Return the reference."""
        return reference

    def rate(self, state: Scalar, reference: Scalar, traction: Scalar, ops: Ops) -> Scalar:
        """Return 0: the state carries nothing."""
        return 0.0 * state


@dataclass(frozen=True)
class Given(Instant):
    """The actuator's measured state in place of its command; effects on commands do not touch it."""


@dataclass(frozen=True, kw_only=True)
class MotorCurrent:
    """A DC motor through a fixed gear; the command is a current in A."""

    torque_constant: Scalar = parameter("N m/A", 1e-4, 1.0, "motor torque per ampere")
    gear_ratio: Scalar = parameter("", 1.0, 50.0, "motor turns per wheel turn")
    efficiency: Scalar = parameter("", 0.1, 1.0, "share of the torque that reaches the wheels")
    wheel_radius: Scalar = parameter("m", 0.01, 0.5, "effective rolling radius")
    rotating_mass: Scalar = parameter("kg", 0.01, 50.0, "inertia of motor, gear and wheels at the tyre, J/R²")
    current_limit: Scalar = parameter("A", 0.1, 500.0, "largest current of either sign")

    def wheel_force(self, current: Scalar, ops: Ops) -> Scalar:
        """Return the force at the tyres in N for a current in A, limited to ± current_limit."""
        limited = ops.maximum(ops.minimum(current, self.current_limit), -self.current_limit)
        return limited * (self.torque_constant * self.gear_ratio * self.efficiency / self.wheel_radius)

    def position(self, state: Scalar, reference: Scalar) -> Scalar:
        """Return the wheel speed itself."""
        return state

    def rate(self, state: Scalar, reference: Scalar, traction: Scalar, ops: Ops) -> Scalar:
        """Return ω̇ from the balance of motor force and traction."""
        return (self.wheel_force(reference, ops) - traction) / self.rotating_mass
