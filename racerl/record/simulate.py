"""One car, driven and measured in continuous time.

The truth is integrated in double precision with steps finer than the control period, by the one derivative that CasADi
has traced. Single precision would not do: after half an hour a step of a millisecond is four units in the last place.
"""

import logging
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from racerl.env.race import LARGEST
from racerl.errors import RunError
from racerl.record.drivers import Drive, Measured, Pose, Scene
from racerl.record.sensors import Sensors
from racerl.vehicle.actuator import MotorCurrent
from racerl.vehicle.bodies import BodyMotion
from racerl.vehicle.delay import delayed, periods
from racerl.vehicle.integrate import advance
from racerl.vehicle.ops import TORCH, CasadiOps
from racerl.vehicle.vehicle import STATE, Vehicle

log = logging.getLogger(__name__)

Array = NDArray[np.float64]
SPEED_GAIN = 40.0  # A per m/s of wheel speed error, where the car takes currents
FAILS_AGAIN = 10  # rows after a car was stood up, within which another failure ends the drive
TRACKING = (0.4, 0.1)  # α, β of the driver's estimate of velocities from poses


class Plant:
    """The car's state, advanced by one control period at a time."""

    def __init__(self, vehicle: Vehicle, pose: Pose, dt: float, step: float) -> None:
        self.state, self._command = np.zeros(len(vehicle.states)), np.zeros(2)
        self._after = np.zeros(len(vehicle.states))
        self.put(pose)
        self._evaluate = self._of_body(vehicle, dt) if vehicle.body else self._traced(vehicle, dt, step)
        self._dt, self._delays = dt, vehicle.delays()
        self._history = [(0.0, 0.0)] * (periods(vehicle, dt) + 1)

    def _traced(self, vehicle: Vehicle, dt: float, step: float) -> Callable[[], None]:
        """Return what advances the arrays in place by the traced equations."""
        import casadi

        steps = max(1, math.ceil(dt / step - 1e-9))
        state, command = casadi.SX.sym("x", len(vehicle.states)), casadi.SX.sym("u", 2)
        after = advance(vehicle, state, command, dt / steps, steps, CasadiOps())
        return self._connected(casadi.Function("advance", [state, command], [after]))

    def _connected(self, function: Any) -> Callable[[], None]:
        """Let a function read and write the arrays in place."""
        self._buffer, evaluate = function.buffer()
        self._buffer.set_arg(0, self.state.data)
        self._buffer.set_arg(1, self._command.data)
        self._buffer.set_res(0, self._after.data)
        return cast(Callable[[], None], evaluate)

    def _of_body(self, vehicle: Vehicle, dt: float) -> Callable[[], None]:
        """Return what advances the arrays in place by a foreign body's own equations."""
        motion = BodyMotion(vehicle, (), dt)

        def evaluate() -> None:
            self._after[:] = motion.advance(0, self.state, self._command.tolist())

        return evaluate

    def put(self, pose: Pose) -> None:
        """Let the car stand somewhere."""
        self.state[:] = 0.0
        self.state[:3] = pose

    def advance(self, delta_ref: float, drive_ref: float) -> None:
        """Hold a command for one control period."""
        self._command[0], self._command[1] = delta_ref, drive_ref
        if self._delays:
            self._history = [(delta_ref, drive_ref), *self._history[:-1]]
            self._command[:] = delayed(self._history, self._delays, 0.0, self._dt, self._dt, TORCH)
        self._evaluate()
        self.state[:] = self._after


class Tracker:
    """An α-β filter per coordinate: the velocities that a driver on board can know."""

    def __init__(self, pose: Pose, dt: float) -> None:
        self.dt = dt
        self.place, self.rate = list(pose), [0.0, 0.0, 0.0]

    def update(self, pose: tuple[float, float, float]) -> tuple[float, float, float]:
        """Return (v_x, v_y, yaw_rate) in the body frame."""
        alpha, beta = TRACKING
        for i, measured in enumerate(pose):
            expected = self.place[i] + self.dt * self.rate[i]
            error = measured - expected
            self.place[i] = expected + alpha * error
            self.rate[i] += beta / self.dt * error
        sin, cos = math.sin(self.place[2]), math.cos(self.place[2])
        x_rate, y_rate, yaw_rate = self.rate
        return cos * x_rate + sin * y_rate, cos * y_rate - sin * x_rate, yaw_rate


@dataclass(frozen=True)
class Recording:
    """A drive of K rows: what was true, what was measured and what was commanded."""

    dt: float  # s
    run: NDArray[np.int64]  # (K,)
    doing: list[str]
    truth: Array  # (K, 8), columns as STATE
    measured: Array  # (K, 6): x, y, yaw, delta, omega, current
    command: Array  # (K, 2): delta_ref in rad, omega_ref in m/s
    motor_current: bool  # the car took currents, not wheel speeds


def simulate(
    vehicle: Vehicle,
    pose: Pose,
    driving: Callable[[Measured], Drive],
    scene: Scene,
    sensors: Sensors,
    *,
    step: float,
    generator: np.random.Generator,
    on_progress: Callable[[float], None] = lambda share: None,
) -> Recording:
    """Drive `vehicle` from `pose` by `driving` for `scene.seconds`, integrated with steps of at most `step` s.

    Where the car takes currents, a speed controller follows the driver's wheel speed. A body whose equations end, as
    those of a car that has spun may, is stood up where it was, and a new run begins.
    """
    dt, rows = scene.dt, round(scene.seconds / scene.dt)
    current_limit = float(vehicle.drive.current_limit) if isinstance(vehicle.drive, MotorCurrent) else None
    plant, tracker = Plant(vehicle, pose, dt, step), Tracker(pose, dt)
    truth, command = np.zeros((rows, len(STATE))), np.zeros((rows, 2))
    measured = sensors.noise(rows, generator)
    run, doing = np.zeros(rows, dtype=np.int64), []
    drive: Drive | None = None
    stood_up, stood = 0, -FAILS_AGAIN
    for k in range(rows):
        if not (np.abs(plant.state) < LARGEST).all():
            if not vehicle.body or k - stood < FAILS_AGAIN:
                last = ", ".join(f"{name} = {value:.4g}" for name, value in zip(STATE, truth[k - 1], strict=True))
                raise RunError(f"the simulation failed at t = {k * dt:.2f} s after {last}; give a smaller step=")
            pose = Pose(*truth[k - 1, :3])
            plant.put(pose)
            tracker, stood_up, stood = Tracker(pose, dt), stood_up + 1, k
        truth[k] = plant.state[: len(STATE)]
        measured[k, :5] += truth[k, [0, 1, 2, 6, 7]]
        x, y, yaw, delta, omega, _ = measured[k].tolist()
        seen = Measured(k * dt, x, y, yaw, *tracker.update((x, y, yaw)), delta, omega)
        if drive is None:
            drive = driving(seen)
            order = next(drive)
        else:
            order = drive.send(seen)
        drive_ref = order.omega_ref
        if current_limit is not None:
            drive_ref = min(max(SPEED_GAIN * (order.omega_ref - omega), -current_limit), current_limit)
            measured[k, 5] += drive_ref
        command[k] = order.delta_ref, order.omega_ref
        run[k] = order.run + stood_up
        doing.append(order.doing)
        plant.advance(order.delta_ref, drive_ref)
        if k % 2000 == 0:
            on_progress(k / rows)
    if stood_up:
        log.warning("its own equations ended %d times, as where a car spins: stood up there, a new run each", stood_up)
    return Recording(dt, run, doing, truth, measured, command, current_limit is not None)
