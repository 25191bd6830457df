"""The race: N independent cars on one track, stepped together.

One control step holds the command for `dt` seconds, integrates the cars in Cartesian coordinates with Runge–Kutta
steps of `step` seconds, projects them onto the track, rewards progress, and starts over the cars whose episode ended.
All arrays are tensors of shape (N,) unless said otherwise.
"""

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, NamedTuple

import torch
from torch import Tensor

from racerl.env.actions import Action
from racerl.env.black_box import BlackBox
from racerl.env.chosen import Chosen, Masked, Numbered
from racerl.env.dice import Dice
from racerl.env.memory import SIZE, filled, moved_on
from racerl.env.observations import Observation, scaled
from racerl.env.randomize import ParameterDraws, Randomization
from racerl.env.reward import progress_reward
from racerl.env.sensing import samples, seen, shown
from racerl.env.termination import STOP_SPEED, OffTrack, Termination, clearance
from racerl.errors import ConfigError
from racerl.track.frenet import PLACE, FrenetFrame
from racerl.track.track import Track
from racerl.vehicle.delay import delayed, periods
from racerl.vehicle.kernel import choose_motion
from racerl.vehicle.ops import TORCH
from racerl.vehicle.parameter import replace_values
from racerl.vehicle.vehicle import STATE, Vehicle

log = logging.getLogger(__name__)

LARGEST = 1e4  # m, rad, m/s, rad/s: what is beyond has failed, as NaN has
START_SPEED_MIN, START_SPEED_MAX = 0.5, 2.0  # m/s, along the centreline
X, Y, YAW, V_X, V_Y, YAW_RATE, DELTA, OMEGA = range(len(STATE))
# all that the next step depends on, beside the drawn parameters and the generator
KEPT = (
    "state",
    "command",
    "command_rate",
    "history",
    "shown",
    "past",
    "place",
    "still_time",
    "travelled",
    "age",
)


@dataclass(frozen=True)
class Timing:
    """Control period, integration step and episode length."""

    dt: float = 0.05  # s
    step: float = 0.01  # s
    max_steps: int = 1024  # control steps until an episode is cut off

    def __post_init__(self) -> None:
        if not 0.001 <= self.dt <= 1.0 or not 0.0001 <= self.step <= self.dt:
            raise ConfigError(f"sim: dt = {self.dt} s (0.001 … 1), step = {self.step} s (0.0001 … dt)")
        if abs(self.dt / self.step - self.substeps) > 1e-6:
            raise ConfigError(f"sim: dt = {self.dt} s is not a multiple of step = {self.step} s; choose a divisor")
        if self.max_steps < 1:
            raise ConfigError(f"sim: max_steps = {self.max_steps}: allowed is at least 1")

    @property
    def substeps(self) -> int:
        """Integration steps per control step."""
        return round(self.dt / self.step)


class Step(NamedTuple):
    """The outcome of one control step, for N cars."""

    observation: Tensor  # (N, O), of the next episode where one ended
    reward: Tensor
    terminated: Tensor  # ended for good
    truncated: Tensor  # cut off; bootstrap with final_observation
    final_observation: Tensor  # (N, O), before any restart
    progress: Tensor  # m along the centreline
    command: Tensor  # (2, N), what was commanded
    margin: Tensor  # m to the nearer boundary, before any restart
    faulty: Tensor  # the simulation failed (NaN) and the car was started over


class Constants:
    """Numbers as tensors of a kind, made once."""

    def __init__(self, device: torch.device, dtype: torch.dtype) -> None:
        self._kind: dict[str, Any] = {"device": device, "dtype": dtype}
        self._made: dict[tuple[float, ...], Tensor] = {}

    def __call__(self, numbers: Sequence[float]) -> Tensor:
        """Return numbers (N,) as a tensor."""
        key = tuple(numbers)
        if key not in self._made:
            self._made[key] = torch.tensor(key, **self._kind)
        return self._made[key]


class Rows:
    """The rows of the cars' states and places by name, each (N,)."""

    v_x = property(lambda self: self.state[V_X])
    v_y = property(lambda self: self.state[V_Y])
    yaw_rate = property(lambda self: self.state[YAW_RATE])
    delta = property(lambda self: self.state[DELTA])
    omega = property(lambda self: self.state[OMEGA])
    s = property(lambda self: self.place[0])
    n = property(lambda self: self.place[1])
    heading = property(lambda self: self.place[2])
    offset = property(lambda self: self.place[3])
    margin = property(lambda self: self.place[4])


@dataclass(frozen=True)
class View(Rows):
    """What observations see of some cars, and what they are divided by."""

    state: Tensor  # (S, N)
    place: Tensor  # (5, N)
    command: Tensor  # (2, N)
    command_rate: Tensor  # (N,)
    past: Tensor  # (P, 7, N), what is remembered of earlier control steps
    frame: FrenetFrame
    action: Action
    constant: Callable[[Sequence[float]], Tensor]
    off: Callable[[Sequence[str]], Tensor]  # shares by which parameters (P) of the cars differ from the model's, (N, P)

    @classmethod
    def of(cls, race: "Race", chosen: Chosen | None) -> "View":
        """Return the view of all cars, or of some."""
        tensors = (*race.seen(), race.command, race.command_rate, race.past)
        if chosen is not None:
            tensors = tuple(map(chosen.take, tensors))  # type: ignore[assignment]
        return cls(*tensors, race.frame, race.action, race.constant, partial(race.draws.off, chosen=chosen))


@dataclass
class Race(Rows):
    """N cars, their track, and what a policy sees and does."""

    vehicle: Vehicle
    track: Track
    observation: Observation
    action: Action
    count: int
    seeds: Sequence[int]  # one for all cars, or one for each
    randomization: Randomization = field(default_factory=Randomization)
    timing: Timing = field(default_factory=Timing)
    termination: Termination = field(default_factory=OffTrack)
    noise: Mapping[str, float] = field(default_factory=dict)  # of what the driver sees, standard deviation per state
    device: torch.device = field(default_factory=lambda: torch.device("cpu"))
    dtype: torch.dtype = torch.float32

    def __post_init__(self) -> None:
        if self.count < 1:
            raise ConfigError(f"cars = {self.count}: allowed is at least 1")
        if len(self.seeds) not in (1, self.count):
            raise ConfigError(f"{len(self.seeds)} seeds for {self.count} cars: give one for all or one for each")
        self.observation = self.observation.fitted(self.track)
        self.dice = Dice(self.seeds, self.count, self.device, self.dtype)
        self.frame = FrenetFrame(self.track, self.device, self.dtype)
        self.constant = Constants(self.device, self.dtype)
        self.draws = ParameterDraws(self.vehicle, self.randomization, self.count, self.device, self.dtype)
        late = periods(self.vehicle, self.timing.dt)
        # commands that act late change within a control step: then the steps are taken one by one
        self.motion = choose_motion(
            self.vehicle,
            self.draws.names,
            self.timing.step,
            1 if late else self.timing.substeps,
            self.device,
            self.dtype,
        )
        # for the device to say whether any car ended or failed; a GPU had better go on than be asked, but for races
        # whose cars have dice of their own, which are thrown one by one
        self.waits = self.device.type == "cpu" or len(self.seeds) > 1
        self._faults = torch.zeros((), device=self.device, dtype=torch.long)
        self._nobody = torch.zeros(self.count, device=self.device, dtype=torch.bool)
        zeros = torch.zeros(self.count, device=self.device, dtype=self.dtype)
        self.state = torch.zeros(len(self.vehicle.states), self.count, device=self.device, dtype=self.dtype)
        self.command = torch.zeros(2, self.count, device=self.device, dtype=self.dtype)
        self.box = BlackBox(self.vehicle.states)
        # the latest commands, newest first, as far as any acts late
        self.history = torch.zeros(late + 1 if late else 0, 2, self.count, device=self.device, dtype=self.dtype)
        # what sensors showed, newest first, where they do not show the truth at once
        noise = self.noise or self.randomization.estimate
        self.spread = self.constant([float(noise.get(name, 0.0)) for name in STATE])[:, None]
        self._noisy = any(noise.values())
        shown_before = samples(self.vehicle, self.timing.dt, self._noisy)
        self._late, self._sensed = late > 0, shown_before > 0
        self.shown = self.state.new_zeros(shown_before, len(STATE), self.count)
        self.past = self.state.new_zeros(self.observation.memory, SIZE, self.count)  # newest first
        self.command_rate, self.still_time = zeros, zeros
        self.place = zeros.new_zeros(len(PLACE), self.count)
        self.travelled = zeros.double()  # m along the centreline, unwrapped since the episode's start
        self.age = torch.zeros(self.count, device=self.device, dtype=torch.long)  # control steps
        self.reset()

    def seen(self) -> tuple[Tensor, Tensor]:
        """Return states (S, N) and places (5, N) as the driver's sensors show them."""
        if not self._sensed:
            return self.state, self.place
        state = self._seen_state()
        return state, self.frame.locate(state[X], state[Y], state[YAW], self.s)[0]

    def _seen_state(self) -> Tensor:
        return seen(self._drawn(), self.shown, self.timing.dt) if self._sensed else self.state

    @property
    def faults(self) -> int:
        """Simulations that failed so far."""
        return int(self._faults)

    @faults.setter
    def faults(self, count: int) -> None:
        self._faults = torch.full_like(self._faults, count)

    def privileged(self) -> Tensor:
        """Return what is drawn of each car, in standard deviations, (N, P): what no sensor shows."""
        return self.draws.privileged()

    def observe(self, chosen: Chosen | None = None) -> Tensor:
        """Return the observation (N, O), inside ± OBSERVATION_LIMIT, of all cars or of some."""
        return scaled(self.observation, View.of(self, chosen))

    def reset(self) -> Tensor:
        """Start all cars over; return the observation (N, O)."""
        self.restart(torch.ones(self.count, device=self.device, dtype=torch.bool))
        return self.observe()

    def put(self, cars: Tensor, state: Tensor, command: Tensor) -> None:
        """Begin the episodes of the cars of these numbers (K,) in states (S, K), with commands (2, K) behind them."""
        place, _ = self.frame.locate(state[X], state[Y], state[YAW], self.frame.nearest(state[X], state[Y]))
        self._begin(Numbered(cars), state, command, place)

    def reseed(self, seeds: Sequence[int]) -> None:
        """Use new seeds from the next restart on."""
        self.dice = Dice(seeds, self.count, self.device, self.dtype)

    @torch.no_grad()
    def step(self, action: Tensor) -> Step:
        """Drive all cars for one control step with actions (N, 2) in [−1, 1]; outside values are clamped."""
        self._apply(action)
        progress, faulty = self._move()
        ended = self.termination(self)
        reward = progress_reward(progress, ended)
        if faulty is not self._nobody:
            reward, ended = reward.masked_fill(faulty, 0.0), ended | faulty
        truncated = (self.age >= self.timing.max_steps) & ~ended
        final, command, margin = self.observe(), self.command, self.margin
        over = ended | truncated
        observation = final
        if not self.waits or bool(over.any()):
            chosen = self.restart(over)
            observation = chosen.put(final.T, self.observe(chosen).T).T
        return Step(observation, reward, ended, truncated, final, progress, command, margin, faulty)

    def drive_on(self, action: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Drive all cars for one control step with actions (N, 2), differentiably; none of them starts over.

        Returns the progress in m, the clearance in m and the cars whose episode would end, (N,) each.
        """
        self._apply(action)
        progress, faulty = self._move()
        return progress, clearance(self), self.termination(self) | faulty

    def _apply(self, action: Tensor) -> None:
        last = self.command
        if self.randomization.actions:
            noise = self.dice.normal(2, torch.arange(self.count, device=self.device))
            action = action + self.randomization.actions * noise.T
        clamped = torch.nan_to_num(action.to(self.dtype)).clamp(-1.0, 1.0)
        self.command = self.action.command(clamped, last, self.timing.dt)
        self.command_rate = (self.command[1] - last[1]) / self.timing.dt
        if self._late:
            self.history = torch.cat([self.command[None], self.history[:-1]])
        if self.observation.memory:
            self.past = moved_on(self.past, self._seen_state(), self.command)

    def _chosen(self, mask: Tensor) -> Chosen:
        return Numbered(mask.nonzero()[:, 0]) if self.waits else Masked(mask)

    def _drawn(self, chosen: Chosen | None = None) -> Vehicle:
        """Return the vehicle with every car's own parameters, of all cars or of some."""
        drawn = self.draws.values if chosen is None else chosen.take(self.draws.values)
        return replace_values(self.vehicle, dict(zip(self.draws.names, drawn.unbind(0), strict=True)))

    def driven(self) -> Tensor:
        """Return the states (S, N) after one control period with the commands as they are."""
        if not self._late:
            return self.motion(self.state, self.command, self.draws.values)
        delays = self._drawn().delays()
        state, step = self.state, self.timing.step
        for number in range(self.timing.substeps):
            acting = delayed(self.history.unbind(0), delays, number * step, step, self.timing.dt, TORCH)
            state = self.motion(state, torch.stack(acting), self.draws.values)
        return state

    def _move(self) -> tuple[Tensor, Tensor]:
        """Integrate and project; return the progress in m and the cars whose state or place is none of this world."""
        if self.waits:
            self.box.note(self.state.detach(), self.command.detach(), self.age)
        moved, faulty = self.driven(), self._nobody
        if not self.waits or not bool(moved.abs().amax() < LARGEST):
            faulty = self._fail(~(moved.abs() < LARGEST).all(dim=0))
            # the state before may be broken too; the car is started over after this step
            moved = torch.where(faulty, torch.where(self.state.abs() < LARGEST, self.state, 0.0), moved)
            self.command = self.command.masked_fill(faulty, 0.0)
            self.command_rate = self.command_rate.masked_fill(faulty, 0.0)
        self.state = moved
        if self._sensed:
            self.shown = torch.cat([self._shown(moved)[None], self.shown[:-1]])
        self.age = self.age + 1
        self.place, progress = self.frame.locate(moved[X], moved[Y], moved[YAW], self.s)
        if not self.waits or not bool(progress.abs().amax() < self.track.length):
            lost = ~(progress.abs() < self.track.length)
            faulty = faulty | self._fail(lost & ~faulty)
            self.place, progress = self.place.masked_fill(lost, 0.0), progress.masked_fill(lost, 0.0)
        travelled = self.travelled + progress
        if self.randomization.each_lap and self.draws.names:
            crossed = (travelled / self.track.length).floor() > (self.travelled / self.track.length).floor()
            self.draws.draw(self._chosen(crossed), self.dice)
        self.travelled = travelled
        self.still_time = (self.still_time + self.timing.dt).masked_fill(self.v_x.abs() >= STOP_SPEED, 0.0)
        return progress, faulty

    def _shown(self, state: Tensor) -> Tensor:
        """Return what the sensors show of all cars' states, with their noise, (8, N)."""
        what = shown(self._drawn(), state)
        if not self._noisy:
            return what
        return what + self.spread * self.dice.normal(len(STATE), torch.arange(self.count, device=self.device))

    def restart(self, mask: Tensor) -> Chosen:
        """Start the masked cars at a random place on the centreline with new parameters; return which they are."""
        chosen = self._chosen(mask)
        self.draws.draw(chosen, self.dice)
        place, pace = self.dice.uniform(2, chosen.cars)
        s = self.frame.wrap(place * self.track.length)
        speed = START_SPEED_MIN + pace * (START_SPEED_MAX - START_SPEED_MIN)
        still = torch.zeros_like(s)
        x, y, yaw = self.frame.position(s, still)
        rest = [still] * (len(self.vehicle.states) - len(STATE))
        state = torch.stack([x, y, yaw, speed, still, still, still, speed, *rest])
        command = torch.stack([still, self.action.initial(speed)])
        self._begin(chosen, state, command, self.frame.place(s, still, still))
        return chosen

    def _begin(self, chosen: Chosen, state: Tensor, command: Tensor, place: Tensor) -> None:
        """Begin the episodes of some cars in states (S, K) at places (5, K)."""
        zeros = torch.zeros_like(state[0])
        self.state = chosen.put(self.state, state)
        self.command = chosen.put(self.command, command)
        self.command_rate = chosen.put(self.command_rate, zeros)
        if self._late:
            self.history = chosen.put(self.history, command.expand(len(self.history), -1, -1))
        first = shown(self._drawn(chosen), state).to(self.dtype) if self._sensed else state
        if self._sensed:
            self.shown = chosen.put(self.shown, first.expand(len(self.shown), -1, -1))
        if self.observation.memory:
            self.past = chosen.put(self.past, filled(first, command, self.observation.memory))
        self.still_time = chosen.put(self.still_time, zeros)
        self.age = chosen.put(self.age, zeros.long())
        self.place = chosen.put(self.place, place)
        self.travelled = chosen.put(self.travelled, place[0].double())

    def _fail(self, faulty: Tensor) -> Tensor:
        """Count cars whose simulation failed, and return them."""
        self._faults = self._faults + faulty.sum()
        if self.waits and bool(faulty.any()):
            self._report(faulty)
        return faulty

    def _report(self, faulty: Tensor) -> None:
        """Log the state from which a simulation failed, and keep what led to it."""
        drawn = dict(zip(self.draws.names, self.draws.values, strict=True))
        self.box.keep(faulty.nonzero()[:, 0], drawn)
        car = int(faulty.nonzero()[0])
        state = ", ".join(
            f"{name} {float(value):.4g}" for name, value in zip(self.vehicle.states, self.state[:, car], strict=True)
        )
        log.warning(
            "simulation failed (NaN) for %d of %d cars, started over; car %d: %s; command %s",
            int(faulty.sum()),
            self.count,
            car,
            state,
            [round(value, 4) for value in self.command[:, car].tolist()],
        )

    def snapshot(self) -> dict[str, Tensor]:
        """Return everything that the next step depends on, as tensors."""
        kept = {name: getattr(self, name) for name in KEPT}
        return {**kept, "parameters": self.draws.values, "dice": self.dice.snapshot()}

    def restore(self, kept: dict[str, Tensor]) -> None:
        """Continue from a snapshot."""
        for name in KEPT:
            setattr(self, name, kept[name].to(self.device))
        self.draws.values = kept["parameters"].to(self.device)
        self.dice.restore(kept["dice"])
