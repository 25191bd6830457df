"""Refinement of a policy by an evolution strategy on its weights: no critic, no discount, no noise in the actions.

Pairs of cars drive from one state, one with weights θ + σ ε, the other with θ − σ ε. What each makes of it until a
crash is F = Σ Δs − price Σ max(0, reserve − d) Δt, the metres of progress less a price for being closer to the boundary
than the reserve, d the distance to it; once crashed a car makes nothing and counts as 0.2 m beyond the boundary. With
w = clip(F₊ − F₋, ± most median |F₊ − F₋|),

    g = Σ w ε,    m ← β m + (1 − β) g,    θ ← θ + α ‖θ‖ m/‖m‖  (layer by layer, norms root-mean-square).

The price is what keeps the car on the track, since it has a slope; the end of an episode at the boundary has none, and
metres lost by the few pairs of which one crosses it drown the centimetres that all others gain. Hence the clip, too.

A layer's ε is a bᵀ with normally distributed a and b, others for every pair (rank one, as EGGROLL has it, 2025): all
cars then share one matrix product. Weights are counted with their inputs' root mean square r as unit, W r, so that no
input decides alone; σ and α are shares of their root mean square and fall. The states are those of cars that the policy
drives; both of a pair have one draw of random parameters. Some of the pairs begin at starts; a start from which a car
left the track is mostly tried again, so that the policy practises what it cannot do.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor
from torch.nn.functional import linear

from racerl import bounds
from racerl.assemble import unlimited
from racerl.control.networks import Map, maps, walk
from racerl.control.policy import AnyPolicy
from racerl.env.race import Race
from racerl.env.races import Races
from racerl.env.termination import CRASH_DISTANCE, Crash
from racerl.train.improve import falling
from racerl.train.practice import Practice
from racerl.train.session import Session

FAINTEST = 1e-3  # root mean square of a layer's input, as which any counts at least


@dataclass(frozen=True)
class Refinement:
    """How long and how boldly; `conf/budget/*.yaml` says what each number is."""

    generations: int
    evaluations: int
    pairs: int
    horizon: int
    between: int
    episode: int
    again: float
    perturbation: Sequence[float]
    step: Sequence[float]
    most: float
    price: float
    reserve: float
    momentum: float

    name: ClassVar[str] = "refinement"
    fact: ClassVar[str] = "refined"
    remedy: ClassVar[str] = "lower budget.refinement.step"

    def __post_init__(self) -> None:
        for name in ("generations", "evaluations", "pairs", "horizon", "between", "episode"):
            bounds.whole(f"budget.refinement.{name}", getattr(self, name), 1, 10**6)
        for name in ("perturbation", "step"):
            expected = "two numbers are expected, the first and the last"
            bounds.pair(f"budget.refinement.{name}", getattr(self, name), 1e-9, 1.0, expected)
        bounds.number("budget.refinement.most", self.most, 1.0, 1e6)
        bounds.number("budget.refinement.price", self.price, 0.0, 1e6)
        bounds.number("budget.refinement.reserve", self.reserve, 0.0, 1.0)
        bounds.number("budget.refinement.momentum", self.momentum, 0.0, 0.999)
        bounds.number("budget.refinement.again", self.again, 0.0, 0.999)

    @property
    def steps(self) -> int:
        """Control steps of a generation, of all cars together."""
        return self.pairs * (2 * self.horizon + self.between)

    @property
    def count(self) -> int:
        """Steps of the weights."""
        return self.generations

    def begin(self, session: Session, policy: AnyPolicy) -> "Search":
        """Return the search that changes a policy in place, in the training's world."""
        world = unlimited(session.settings)
        lead = session.build_races(self.pairs, world)
        race = session.build_races(self.pairs, world, 2, Crash())
        return Search(self, policy, lead, race, session.seed)


class Search:
    """An evolution strategy in the course of a refinement: the policy's weights, their momentum, and the cars."""

    def __init__(
        self,
        settings: Refinement,
        policy: AnyPolicy,
        lead: Race | Races,
        race: Race | Races,
        seed: int,
    ) -> None:
        """`lead` has a car for every pair, `race` those twice over; the policy's weights are changed in place."""
        self.settings, self.lead, self.race = settings, lead, race
        self.dice = torch.Generator(self.lead.device).manual_seed(seed)
        self.practice = Practice(self.lead, policy, settings, self.dice)
        self.network = policy.network
        self.maps = maps(policy.network)
        self.momentum = [torch.zeros_like(_whole(own)) for own in self.maps]
        self.done = 0

    @torch.no_grad()
    def advance(self) -> dict[str, float]:
        """Take one step of the weights; return its measures."""
        settings = self.settings
        sigma = falling(settings.perturbation, self.done, settings.count)
        alpha = falling(settings.step, self.done, settings.count)
        self.practice.drive()
        self.practice.copy_into(self.race)  # both cars of every pair where a car stands that the policy drives
        scales = self._scales()
        normal = self._normal(scales)
        sizes = [_rms(_whole(own) * scale) for own, scale in zip(self.maps, scales, strict=True)]
        fitness = self._fitness(normal, [sigma * size for size in sizes])
        ahead, behind = fitness.chunk(2)
        gain = ahead - behind
        most = settings.most * gain.abs().median()
        weight = gain.clamp(-most, most)
        for i, ((weights, biases), (a, b)) in enumerate(zip(self.maps, normal, strict=True)):
            slope = (a * weight[:, None]).T @ (b * scales[i])
            self.momentum[i] = settings.momentum * self.momentum[i] + (1.0 - settings.momentum) * slope
            length = _rms(self.momentum[i])
            if length > 0.0:
                step = alpha * sizes[i] / length * self.momentum[i] / scales[i]
                weights.add_(step[:, :-1])
                biases.add_(step[:, -1])
        self.done += 1
        return {"fitness": float(fitness.mean()), "crashes": float(self.crashed.float().mean())}

    def _scales(self) -> list[Tensor]:
        """Return the root mean square of every map's inputs (in + 1,), over the cars that the policy drives."""
        found = []

        def measured(i: int, x: Tensor) -> Tensor:
            found.append(torch.cat([x.square().mean(dim=0).sqrt(), x.new_ones(1)]).clamp(min=FAINTEST))
            return linear(x, *self.maps[i])

        walk(self.network, self.lead.observe(), self.practice.memory, measured)
        return found

    def snapshot(self) -> dict[str, Tensor]:
        """Return all that the next generation depends on, but for its number."""
        momentum = {f"momentum.{i}": tensor for i, tensor in enumerate(self.momentum)}
        return self.practice.snapshot() | momentum | {"race.dice": self.race.dice.snapshot()}

    def restore(self, tensors: dict[str, Tensor], state: Mapping[str, Any]) -> None:
        """Go on from a snapshot."""
        self.practice.restore(tensors)
        self.momentum = [tensors[f"momentum.{i}"].to(self.lead.device) for i in range(len(self.maps))]
        self.race.dice.restore(tensors["race.dice"])
        self.done = state["done"]

    def _normal(self, scales: Sequence[Tensor]) -> list[tuple[Tensor, Tensor]]:
        """Return a and b/r of every map and pair, of its outputs (P, out) and its inputs and bias (P, in + 1)."""

        def draw(size: int) -> Tensor:
            return torch.randn(self.settings.pairs, size, generator=self.dice, device=self.lead.device)

        return [
            (draw(len(biases)), draw(len(scale)) / scale) for (_, biases), scale in zip(self.maps, scales, strict=True)
        ]

    def _fitness(self, normal: Sequence[tuple[Tensor, Tensor]], sizes: Sequence[Tensor]) -> Tensor:
        """Return what all cars make (2 P,) in m: progress until they crash, less the price of the boundary."""
        race, settings = self.race, self.settings
        self.crashed = torch.zeros(race.count, dtype=torch.bool, device=race.device)
        fitness = torch.zeros(race.count, device=race.device)
        observation, memory = race.observe(), torch.cat([self.practice.memory] * 2)
        for _ in range(settings.horizon):
            action, memory = self._perturbed(observation, memory, normal, sizes)
            step = race.step(action)
            self.crashed |= step.terminated
            margin = step.margin.masked_fill(self.crashed, -CRASH_DISTANCE)
            close = (settings.reserve - margin).clamp(min=0.0)
            fitness += step.progress.masked_fill(self.crashed, 0.0) - settings.price * race.timing.dt * close
            observation = step.observation
        return fitness

    def _perturbed(
        self, observation: Tensor, memory: Tensor, normal: Sequence[tuple[Tensor, Tensor]], sizes: Sequence[Tensor]
    ) -> tuple[Tensor, Tensor]:
        """Return the actions (2 P, 2) and the next memories of the networks θ ± σ ε."""
        half = len(observation) // 2

        def apply(i: int, x: Tensor) -> Tensor:
            (a, b), y = normal[i], linear(x, *self.maps[i])
            for part, sign in ((slice(None, half), 1.0), (slice(half, None), -1.0)):
                along = (x[part] * b[:, :-1]).sum(dim=1) + b[:, -1]
                y[part] += (sign * sizes[i] * along)[:, None] * a
            return y

        return walk(self.network, observation, memory, apply)


def _whole(own: Map) -> Tensor:
    """Return a map's weights with its biases as the last column."""
    weights, biases = own
    return torch.cat([weights, biases[:, None]], dim=1)


def _rms(values: Tensor) -> Tensor:
    return values.square().mean().sqrt()
