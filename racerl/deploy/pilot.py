"""A policy at the wheel of one real car: what its sensors say in, references out, a stop where they cannot be trusted.

What was measured is some milliseconds old, and what is commanded acts some milliseconds late. So the car's own
equations are driven forward over both, with the commands that were given; the policy sees the car as it will be. What
it sees is computed by the observation that it was trained with.
"""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor

from racerl import bounds
from racerl.deploy.trained import load_trained
from racerl.env.memory import filled, moved_on
from racerl.env.observations import scaled
from racerl.env.race import Constants, View
from racerl.errors import ConfigError
from racerl.track.frenet import FrenetFrame
from racerl.vehicle.kernel import choose_motion
from racerl.vehicle.load import load_vehicle
from racerl.vehicle.vehicle import COMMAND, STATE

STEP = 0.005  # s, of the prediction
CPU = torch.device("cpu")
DELTA, OMEGA = STATE.index("delta"), STATE.index("omega")


class Sensed(NamedTuple):
    """One car as it was measured at a time; δ may be NaN, where no sensor tells it."""

    time: float  # s
    x: float  # m
    y: float  # m
    yaw: float  # rad
    v_x: float  # m/s
    v_y: float  # m/s
    yaw_rate: float  # rad/s
    delta: float  # rad
    omega: float  # m/s, of the wheel's surface


class Order(NamedTuple):
    """What the car is told; `why` says what stands in the way where it has to stop."""

    delta_ref: float  # rad
    drive_ref: float  # m/s
    why: str


def as_modelled(names: Sequence[str]) -> Tensor:
    """Return by which shares the car's parameters are known to differ from its model's, (1, P): by none."""
    return torch.zeros(1, len(names))


@dataclass(frozen=True)
class Guard:
    """When not to drive."""

    stale: float = 0.2  # s, age of what was measured
    off_track: float = 0.1  # m beyond the boundary
    slow: float = 2.0  # control periods between two orders
    settle: float = 0.5  # s of sound data before it drives (again)

    def __post_init__(self) -> None:
        for name, high in (("stale", 10.0), ("off_track", 100.0), ("slow", 100.0), ("settle", 60.0)):
            bounds.number(f"guard.{name}", getattr(self, name), 0.0, high)


class Pilot:
    """Drives one car by steering angle and wheel speed, which is at most `most` in m/s.

    `delay` is by how many seconds orders act late, on top of what the vehicle says itself. Raises RunError, PolicyError
    or ConfigError for a run that cannot drive.
    """

    def __init__(self, run: Path, delay: float = 0.0, guard: Guard | None = None, most: float = math.inf) -> None:
        trained = load_trained(run)
        self.policy, self.observation, self.action = trained.policy, trained.observation, trained.action
        if self.action.drive_mode != "wheel_speed":
            raise ConfigError(
                f"{run}: commands a {self.action.drive_mode}, and a car stands by a speed of 0; train with "
                "action=speed_rate or action=speed"
            )
        self.period = trained.dt
        self.frame = FrenetFrame(trained.track, CPU, torch.float32)
        settings = trained.origin.settings
        # a real car has actuators, whatever the policy was trained with
        self.vehicle = load_vehicle(settings["vehicle"], drive=settings["sim"]["drive"])
        self.delay = bounds.number("delay", delay, 0.0, 1.0, "s")
        self.guard, self.most = guard or Guard(), most
        self._motion = choose_motion(self.vehicle, (), STEP, 1, CPU, torch.float32)
        # time, δ_ref, drive reference
        self._given: deque[tuple[float, float, float]] = deque([(-math.inf, 0.0, 0.0)], maxlen=1000)
        self._constant = Constants(CPU, torch.float32)
        self._s: Tensor | None = None
        self._sound_since = self._asked = math.nan
        self._delta = 0.0  # as the steering's model has it
        self._rate = 0.0  # of the drive reference
        self._past: Tensor  # what was ordered on the steps before, and where the car was then
        self._memory: Tensor  # of the policy (1, U)
        self._driving = False

    def drive(self, sensed: Sensed, now: float) -> Order:
        """Return what to tell the car now, on the clock of `sensed.time`."""
        late, self._asked = now - self._asked, now
        why = self._doubt(sensed, now, late)
        self._delta = self._steered(late)
        if why:
            return self._stop(now, why)
        state = self.predict(sensed, now + self.delay)
        place = self._place(state)
        if float(place[4]) < -self.guard.off_track:
            return self._stop(now, f"{-float(place[4]):.2f} m off the track")
        if math.isnan(self._sound_since):
            self._sound_since = now
        if now - self._sound_since < self.guard.settle - 1e-6:
            return self._stop(now, "waiting until the data have been sound for a while", sound=True)
        return self._order(state, place, now)

    def _order(self, state: Tensor, place: Tensor, now: float) -> Order:
        steering, drive = self._given[-1][1:]
        if not self._driving:
            drive, self._rate = float(self.action.initial(state[OMEGA])), 0.0
        last, rate = torch.tensor([[steering], [drive]]), torch.tensor([self._rate])
        if not self._driving:
            self._past = filled(state, last, self.observation.memory)
            self._memory = torch.zeros(1, self.policy.units)
        view = View(state, place, last, rate, self._past, self.frame, self.action, self._constant, as_modelled)
        action, self._memory = self.policy.decide(scaled(self.observation, view), self._memory)
        command = self.action.command(action, last, self.period)
        self._driving = True
        delta_ref, drive_ref = command[:, 0].tolist()
        if not (math.isfinite(delta_ref) and math.isfinite(drive_ref)):
            return self._stop(now, "the policy gave no finite references")
        # what is told is what is known of: the car is driven forward with it
        drive_ref = min(drive_ref, self.most)
        self._rate = (drive_ref - drive) / self.period
        self._past = moved_on(self._past, state, torch.tensor([[delta_ref], [drive_ref]]))
        self._given.append((now, delta_ref, drive_ref))
        return Order(delta_ref, drive_ref, "")

    def predict(self, sensed: Sensed, until: float) -> Tensor:
        """Return the state (S, 1) at a later time, driven by the orders that act until then."""
        measured = list(sensed[1:])
        if math.isnan(sensed.delta):
            measured[DELTA] = self._delta
        rest = [0.0] * (len(self.vehicle.states) - len(STATE))
        state = torch.tensor([*measured, *rest])[:, None]
        time = sensed.time
        while time < until - 1e-9:
            acting = torch.tensor(self._acting(time + STEP / 2))[:, None]
            state = self._motion(state, acting, torch.empty(0, 1))
            time += STEP
        return state

    def _acting(self, time: float) -> list[float]:
        """Return the references that act on the car at a time."""
        delays = self.vehicle.delays()
        found = []
        for column, name in enumerate(COMMAND, start=1):
            at = time - self.delay - float(delays.get(name, 0.0))
            found.append(next((given[column] for given in reversed(self._given) if given[0] <= at), 0.0))
        return found

    def _steered(self, late: float) -> float:
        """Return the steering angle one period further on: δ ← δ + (δ_ref − δ)(1 − e^{−Δt/T})."""
        lag = float(getattr(self.vehicle.steering, "time_constant", 0.0))
        share = 1.0 if lag <= 0.0 or not math.isfinite(late) else 1.0 - math.exp(-late / lag)
        return self._delta + share * (self._acting(self._asked)[0] - self._delta)

    def _doubt(self, sensed: Sensed, now: float, late: float) -> str:
        """Return what is wrong with the data; empty where nothing is."""
        if not math.isfinite(sensed.time):
            return "nothing was measured yet"
        age = now - sensed.time
        if not -self.period <= age <= self.guard.stale:
            return f"the data are {age:.2f} s old, at most {self.guard.stale:g} s are allowed"
        values = sensed._asdict()
        if bad := [name for name, value in values.items() if not math.isfinite(value) and name != "delta"]:
            return f"no finite {', '.join(bad)}"
        if math.isinf(sensed.delta):
            return "no finite delta"
        if late > self.guard.slow * self.period:
            return f"asked after {late:.2f} s, every {self.period:g} s are expected"
        return ""

    def _stop(self, now: float, why: str, sound: bool = False) -> Order:
        """Tell the car to stand, its wheels as they were."""
        self._driving = False
        if not sound:
            self._sound_since, self._s = math.nan, None
        delta_ref = self._given[-1][1]
        self._given.append((now, delta_ref, 0.0))
        return Order(delta_ref, 0.0, why)

    def _place(self, state: Tensor) -> Tensor:
        """Return the car's place (5, 1) on the track, looked for near the last one."""
        x, y, yaw = state[:3]
        if self._s is None:
            self._s = self.frame.nearest(x, y)
        place, _ = self.frame.locate(x, y, yaw, self._s)
        self._s = place[0]
        return place
