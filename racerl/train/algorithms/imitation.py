"""Imitation of a teacher that knows the car (DAgger): the policy drives, the teacher says what it would have done.

All that was ever seen is kept and fitted again after every round, so that the policy learns to come back from its own
mistakes. Targets reach a little beyond ± 1, where the race clamps; a network that is further out on the same side is
not pulled back.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn

from racerl import bounds
from racerl.assemble import build_race, unlimited
from racerl.control.policy import build_network
from racerl.env.race import Race
from racerl.train.products import fast_products
from racerl.train.session import Progress, Session, policy_of
from racerl.train.teacher import Teacher, find_teacher

# greatest of the whole numbers, and least and greatest of the others
WHOLE = {
    "rounds": 10**6,
    "cars": 10**6,
    "steps": 10**6,
    "handing_over": 10**6,
    "batch": 10**9,
    "updates": 10**6,
    "last_updates": 10**6,
    "examined_every": 10**6,
}
RANGES = {
    "fast_starts": (0.0, 1.0),
    "noise": (0.0, 10.0),
    "largest_target": (1.0, 10.0),
    "learning_rate": (1e-9, 1.0),
    "last_rate": (1e-9, 1.0),
}


@dataclass(frozen=True)
class Imitation:
    """How much is driven and how long it is fitted; `conf/algo/imitation.yaml` says what each number is."""

    rounds: int
    cars: int
    steps: int
    handing_over: int
    fast_starts: float
    noise: float
    largest_target: float
    batch: int
    updates: int
    last_updates: int
    learning_rate: float
    last_rate: float
    layers: Sequence[int]
    examined_every: int

    def __post_init__(self) -> None:
        for name, most in WHOLE.items():
            bounds.whole(f"algo.{name}", getattr(self, name), 1, most)
        for name, (low, high) in RANGES.items():
            bounds.number(f"algo.{name}", getattr(self, name), low, high)
        bounds.layers("algo.layers", self.layers)

    def train(self, session: Session) -> dict[str, Any]:
        """Drive and fit for `rounds` rounds."""

        def build(settings: Mapping[str, Any]) -> Race:
            return build_race(settings, cars=self.cars, seeds=[session.seed], device=session.device)

        race = build(session.settings)
        session.start()
        # a lap at the limit is beyond a car with less grip, however good its feedback: trials are of the plain car
        plain = unlimited({**session.settings, "dr": {"sigma": 0.0, "parameters": []}})
        teacher = find_teacher(lambda: build(plain))
        torch.manual_seed(session.seed)
        network = build_network([race.observation.size, *self.layers, 2]).to(session.device)
        optimizer = torch.optim.Adam(network.parameters(), self.learning_rate)
        dice = torch.Generator(session.device).manual_seed(session.seed)
        self._start_fast(race, teacher, race.age == 0, dice)
        seen: list[Tensor] = []
        asked: list[Tensor] = []
        for number in range(self.rounds):
            reward = self._drive(race, teacher, network, 1.0 - number / self.handing_over, dice, seen, asked)
            last = number == self.rounds - 1
            with fast_products(session.device):
                loss = self._fit(network, optimizer, torch.cat(seen), torch.cat(asked), last, dice)
            steps = (number + 1) * self.cars * self.steps
            if last or (number + 1) % self.examined_every == 0:
                # one flying lap from a standing start says little of the pace: the policy that has seen most is kept
                session.examine(policy_of(network, race, session.settings), steps, improving=True)
            session.logger.record("train/loss", loss)
            session.logger.record("train/reward", reward)
            session.logger.dump(steps)
            total = self.rounds * self.cars * self.steps
            session.on_progress(Progress(steps, total, session.seconds, steps / session.seconds, reward, session.last))
        return {"steps": self.rounds * self.cars * self.steps, "nan_cars": race.faults}

    @torch.no_grad()
    def _drive(
        self,
        race: Race,
        teacher: Teacher,
        network: nn.Module,
        taught: float,
        dice: torch.Generator,
        seen: list[Tensor],
        asked: list[Tensor],
    ) -> float:
        """Drive all cars, a share `taught` of them by the teacher; keep what was seen; return the mean reward."""
        by_teacher = (torch.rand(race.count, generator=dice, device=race.device) < taught)[:, None]
        rewards = []
        observation = race.observe()
        for _ in range(self.steps):
            target = teacher(race).clamp(-self.largest_target, self.largest_target)
            seen.append(observation)
            asked.append(target)
            action = torch.where(by_teacher, target, network(observation)).clamp(-1.0, 1.0)
            step = race.step(action + self.noise * torch.randn(action.shape, generator=dice, device=race.device))
            observation = step.observation
            rewards.append(step.reward.mean())
            over = step.terminated | step.truncated
            if bool(over.any()):
                self._start_fast(race, teacher, over, dice)
                observation = race.observe()
        return float(torch.stack(rewards).mean())

    def _start_fast(self, race: Race, teacher: Teacher, begun: Tensor, dice: torch.Generator) -> None:
        """Put a share of the cars that begin an episode near the fastest lap."""
        fast = begun & (torch.rand(race.count, generator=dice, device=race.device) < self.fast_starts)
        if bool(fast.any()):
            teacher.start(race, fast.nonzero()[:, 0], dice)

    def _fit(
        self,
        network: nn.Module,
        optimizer: torch.optim.Optimizer,
        seen: Tensor,
        asked: Tensor,
        last: bool,
        dice: torch.Generator,
    ) -> float:
        """Fit the network to all that was asked of it; return the mean loss."""
        count = self.last_updates if last else self.updates
        losses = []
        for update in range(count):
            falling = 1.0 - (1.0 - self.last_rate) * update / count if last else 1.0
            optimizer.param_groups[0]["lr"] = self.learning_rate * falling
            chosen = torch.randint(0, len(seen), (self.batch,), generator=dice, device=seen.device)
            answer, target = network(seen.index_select(0, chosen)), asked.index_select(0, chosen)
            beyond = (target.abs() >= self.largest_target) & (answer * target.sign() > self.largest_target)
            loss = ((answer - target) ** 2).masked_fill(beyond, 0.0).mean()
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            losses.append(loss.detach())
        return float(torch.stack(losses).mean())
