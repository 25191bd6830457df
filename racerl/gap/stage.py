"""The chain from command to motion, cut into stages that are judged apart, so that their effects do not compete.

    steering  command → measured steering angle
    drive     command → measured wheel speed
    chassis   measured steering angle and wheel speed → pose and velocities

The whole chain, from the commands to the motion, is looked at, too, but decides nothing.

What a stage takes as input is known as it was logged: sensors are undone on measured inputs, and only differences of
timing matter. With τ = delay of the input +
latency of the outputs − latency of the input, input i acts as u_i(t − τ_i). Inputs are shifted to the current τ ahead
of a rollout; a further shift is linear, u_i − Δτ_i u̇_i, which gives the sensitivity to it.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Any

from racerl.vehicle.effects import Effect
from racerl.vehicle.ops import Ops
from racerl.vehicle.parameter import replace_values
from racerl.vehicle.rollout import Equations, Rollout, drive_by, true_inputs
from racerl.vehicle.vehicle import Vehicle

SHIFTS = ("shift.steering", "shift.drive")  # s, of the two inputs


@dataclass(frozen=True)
class Stage:
    """One link of the chain: its two inputs and its outputs, channels of the log."""

    name: str
    inputs: tuple[str, str]
    outputs: tuple[str, ...]

    @property
    def needed(self) -> tuple[str, ...]:
        """Inputs that a log must have; to a steering command the wheel speed is of little matter."""
        return self.inputs[:1] if self.name == "steering" else self.inputs

    def vehicle(self, vehicle: Vehicle) -> Vehicle:
        """Return the vehicle with the stage's measured inputs in place of its actuators."""
        return drive_by(vehicle, measured_steering=self.inputs[0] == "delta", measured_speed=self.inputs[1] == "omega")

    def shifts(self, late: Effect | Vehicle) -> tuple[float, float]:
        """Return by how many seconds an effect, or all effects of a vehicle, shift the inputs against the outputs."""
        delays, latencies = late.delays(), late.latencies()
        # a command's delay acts on the way to its own actuator only
        steering = delays.get("delta_ref", 0.0) if self.inputs[0] == "delta_ref" else 0.0
        drive = delays.get("drive_ref", 0.0) if self.inputs[1] == "omega_ref" else 0.0
        shown, (first, second) = latencies.get(self.outputs[0], 0.0), self.inputs
        return steering + shown - latencies.get(first, 0.0), drive + shown - latencies.get(second, 0.0)


STEERING = Stage("steering", ("delta_ref", "omega"), ("delta",))
DRIVE = Stage("drive", ("delta", "omega_ref"), ("omega",))
CHASSIS = Stage("chassis", ("delta", "omega"), ("x", "y", "yaw", "v_x", "v_y", "yaw_rate"))
TYRES = CHASSIS.name  # the stage that has tyres
CHAIN = replace(CHASSIS, name="chain", inputs=("delta_ref", "omega_ref"))


def stages(channels: Collection[str]) -> tuple[Stage, ...]:
    """Return the stages of logs with these channels; where an actuator was not measured, its command drives."""
    steering = "delta" if "delta" in channels or "delta_ref" not in channels else "delta_ref"
    drive = "omega" if "omega" in channels or "omega_ref" not in channels else "omega_ref"
    return STEERING, DRIVE, replace(CHASSIS, inputs=(steering, drive))


class StageEquations(Equations):
    """A stage's equations. Its inputs are (delta, drive) as logged, then their time derivatives."""

    inputs = 4

    def car(self, parameters: Sequence[Any]) -> Vehicle:
        """Return the vehicle with other parameters; shifts are not its own."""
        named = zip([*self.names, *self.given], parameters, strict=True)
        return replace_values(self.vehicle, {name: value for name, value in named if name not in SHIFTS})

    def derivative(self, state: Any, inputs: Any, parameters: Sequence[Any], ops: Ops) -> Any:
        """Return d(state)/dt under inputs (4, N)."""
        car = self.car(parameters)
        named = dict(zip([*self.names, *self.given], parameters, strict=True))
        steering, drive, steering_rate, drive_rate = ops.unstack(inputs)
        shown = {
            "delta": steering - named.get(SHIFTS[0], 0.0) * steering_rate,
            "omega": drive - named.get(SHIFTS[1], 0.0) * drive_rate,
        }
        return car.derivative(state, ops.stack(list(true_inputs(car, shown, ops).values())), ops)


class StageRollout(StageEquations, Rollout):
    """The rollouts of a stage."""
