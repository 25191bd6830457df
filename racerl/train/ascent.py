"""Ascent of a policy along the gradient of what it drives: no critic, no discount, no noise added, no perturbations.

Cars drive on from states in which the policy drives. What each makes of it until a crash is

    F = Σ Δs − price Σ max(0, reserve − d)² Δt,

the metres of progress less a price for being closer to the boundary than the reserve. d is the distance to it, or,
where that is less, 0.33 m for every rad that is left of a quarter turn against the track: a spin ends an episode
without a slope of its own. Once crashed a car makes nothing and counts as 0.2 m beyond the boundary. Car, track,
observation and network are differentiated backwards through all control steps (backpropagation through time), car and
track by the adjoints of their compiled code: ∂F/∂θ is exact where no car crashes and nothing is at a limit.

RAdam climbs it. Adam's first steps go by the signs of one gradient, at full length, and a policy at its limits does not
survive them; RAdam's are small.

The square lets the price rise evenly. With a price that begins at once, as the refinement has it, the gradient leaps
at the reserve, steps go to and fro across it, and laps stay where they are.

An output at its limit gets no gradient that would push it on, but one that brings it back.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor, nn
from torch.nn.functional import linear

from racerl import bounds
from racerl.assemble import unlimited
from racerl.control.networks import forgotten, maps, walk
from racerl.control.policy import AnyPolicy
from racerl.env.race import Race
from racerl.env.races import Races
from racerl.env.termination import CRASH_DISTANCE, Crash
from racerl.train.checkpoint import load_optimizer, optimizer_tensors, section
from racerl.train.improve import falling
from racerl.train.practice import Practice
from racerl.train.session import Session


@dataclass(frozen=True)
class Ascent:
    """How long and how boldly; `conf/budget/laptop.yaml` says what each number is."""

    updates: int
    evaluations: int
    cars: int
    horizon: int
    between: int
    episode: int
    again: float
    learning_rate: Sequence[float]
    betas: Sequence[float]
    gradient_norm: float
    price: float
    reserve: float

    name: ClassVar[str] = "ascent"
    fact: ClassVar[str] = "ascended"
    remedy: ClassVar[str] = "lower budget.ascent.learning_rate"

    def __post_init__(self) -> None:
        for name in ("updates", "evaluations", "cars", "horizon", "between", "episode"):
            bounds.whole(f"budget.ascent.{name}", getattr(self, name), 1, 10**6)
        bounds.pair(
            "budget.ascent.learning_rate",
            self.learning_rate,
            1e-9,
            1.0,
            "two numbers are expected, the first and the last",
        )
        bounds.pair("budget.ascent.betas", self.betas, 1e-9, 0.9999, "two shares are expected")
        bounds.number("budget.ascent.again", self.again, 0.0, 0.999)
        bounds.number("budget.ascent.gradient_norm", self.gradient_norm, 1e-9, 1e9)
        bounds.number("budget.ascent.price", self.price, 0.0, 1e6)
        bounds.number("budget.ascent.reserve", self.reserve, 0.0, 0.5)

    @property
    def count(self) -> int:
        """Steps of the weights."""
        return self.updates

    @property
    def steps(self) -> int:
        """Control steps of an update, of all cars together."""
        return self.cars * (self.horizon + self.between)

    def begin(self, session: Session, policy: AnyPolicy) -> "Climb":
        """Return the climb that changes a policy in place, in the training's world."""
        world = unlimited(session.settings)
        lead, race = (session.build_races(self.cars, world, termination=end) for end in (None, Crash()))
        return Climb(self, policy, lead, race, session.seed)


class Climb:
    """A policy in the course of an ascent: its weights, RAdam's moments, and the cars."""

    def __init__(self, settings: Ascent, policy: AnyPolicy, lead: Race | Races, race: Race | Races, seed: int) -> None:
        """`lead` and `race` have as many cars; the policy's weights are changed in place."""
        self.settings, self.lead, self.race = settings, lead, race
        self.practice = Practice(lead, policy, settings, torch.Generator(lead.device).manual_seed(seed))
        self.network: nn.Module = policy.network.requires_grad_()
        first, second = settings.betas
        self.optimizer = torch.optim.RAdam(
            self.network.parameters(), lr=settings.learning_rate[0], betas=(first, second)
        )
        self.done = 0

    def advance(self) -> dict[str, float]:
        """Take one step of the weights; return its measures."""
        settings = self.settings
        for group in self.optimizer.param_groups:
            group["lr"] = falling(settings.learning_rate, self.done, settings.updates)
        with torch.no_grad():
            self.practice.drive()
        made, crashed = self._drive()
        self.optimizer.zero_grad()
        (-made.mean()).backward()
        length = nn.utils.clip_grad_norm_(self.network.parameters(), settings.gradient_norm)
        self.optimizer.step()
        self.done += 1
        crashes = float(crashed.float().mean())
        return {"fitness": float(made.detach().mean()), "crashes": crashes, "gradient": float(length)}

    def _drive(self) -> tuple[Tensor, Tensor]:
        """Return what all cars make (N,) in m, by the weights differentiable, and which of them crashed."""
        race, settings = self.race, self.settings
        self.practice.copy_into(race)
        memory, layers = self.practice.memory, maps(self.network)
        crashed = torch.zeros(race.count, dtype=torch.bool, device=race.device)
        made = torch.zeros(race.count, device=race.device)
        for _ in range(settings.horizon):
            action, memory = walk(self.network, race.observe(), memory, lambda i, x: linear(x, *layers[i]))
            progress, clear, ended = race.drive_on(_Limited.apply(action))
            crashed = crashed | ended
            memory = forgotten(memory, ended)
            close = (settings.reserve - clear.masked_fill(crashed, -CRASH_DISTANCE)).clamp(min=0.0)
            made = made + progress.masked_fill(crashed, 0.0) - settings.price * race.timing.dt * close.square()
        return made, crashed

    def snapshot(self) -> dict[str, Tensor]:
        """Return all that the next update depends on, but for its number."""
        moments = {f"adam.{name}": tensor for name, tensor in optimizer_tensors(self.optimizer).items()}
        return self.practice.snapshot() | moments | {"race.dice": self.race.dice.snapshot()}

    def restore(self, tensors: dict[str, Tensor], state: Mapping[str, Any]) -> None:
        """Go on from a snapshot."""
        self.practice.restore(tensors)
        load_optimizer(self.optimizer, section(tensors, "adam."))
        self.race.dice.restore(tensors["race.dice"])
        self.done = state["done"]


class _Limited(torch.autograd.Function):
    """Outputs inside ± 1, whose gradient by ascent may lead back from a limit but not beyond it."""

    @staticmethod
    def forward(ctx: Any, outputs: Tensor) -> Tensor:
        ctx.save_for_backward(outputs)
        return outputs.clamp(-1.0, 1.0)

    @staticmethod
    def backward(ctx: Any, *slopes: Tensor) -> Tensor:
        (outputs,), (slope,) = ctx.saved_tensors, slopes  # of what is made less: against its slope the weights go
        beyond = ((outputs > 1.0) & (slope < 0.0)) | ((outputs < -1.0) & (slope > 0.0))
        return slope.masked_fill(beyond, 0.0)
