"""Imitation of a teacher that knows the car (DAgger): the policy drives, the teacher says what it would have done.

All that was ever seen is kept and fitted again after every round, so that the policy learns to come back from its own
mistakes. Targets reach a little beyond ± 1, where the race clamps; a network that is further out on the same side is
not pulled back.
"""

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn

from racerl.assemble import build_race
from racerl.control.policy import build_network
from racerl.env.race import Race
from racerl.errors import ConfigError
from racerl.train.products import fast_products
from racerl.train.session import Progress, Session, policy_of
from racerl.train.teacher import Teacher

LARGEST = 1.3  # of a target
HANDING_OVER = 4  # rounds until the teacher no longer drives
LAST_RATE = 0.02  # of the learning rate, at the end of the last fit
EXAMINED_EVERY = 5  # rounds


@dataclass(frozen=True)
class Imitation:
    """How much is driven and how long it is fitted."""

    rounds: int = 40
    cars: int = 256
    steps: int = 40  # control steps of each car per round
    batch: int = 2048
    updates: int = 100  # after each round
    last_updates: int = 600  # after the last, with a falling learning rate
    learning_rate: float = 1e-3
    layers: tuple[int, ...] = (256, 256)
    noise: float = 0.05  # of the actions that are driven
    fast_starts: float = 0.5  # share of episodes that begin near the fastest lap

    def __post_init__(self) -> None:
        for name in ("rounds", "cars", "steps", "batch", "updates", "last_updates"):
            if int(getattr(self, name)) != getattr(self, name) or getattr(self, name) < 1:
                raise ConfigError(f"algo.{name} = {getattr(self, name)}: allowed is a whole number, at least 1")
        if not self.learning_rate > 0 or self.noise < 0 or not 0 <= self.fast_starts <= 1:
            raise ConfigError("algo: learning_rate > 0, noise ≥ 0 and fast_starts in 0 … 1 are allowed")

    def train(self, session: Session) -> dict[str, Any]:
        """Drive and fit for `rounds` rounds."""
        race = build_race(session.settings, cars=self.cars, seeds=[session.seed], device=session.device)
        session.start()
        teacher = Teacher(race)
        torch.manual_seed(session.seed)
        network = build_network([race.observation.size, *self.layers, 2]).to(session.device)
        optimizer = torch.optim.Adam(network.parameters(), self.learning_rate)
        dice = torch.Generator(session.device).manual_seed(session.seed)
        self._start_fast(race, teacher, race.age == 0, dice)
        seen: list[Tensor] = []
        asked: list[Tensor] = []
        for number in range(self.rounds):
            reward = self._drive(race, teacher, network, 1.0 - number / HANDING_OVER, dice, seen, asked)
            last = number == self.rounds - 1
            with fast_products(session.device):
                loss = self._fit(network, optimizer, torch.cat(seen), torch.cat(asked), last, dice)
            steps = (number + 1) * self.cars * self.steps
            if last or number % EXAMINED_EVERY == EXAMINED_EVERY - 1:
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
            target = teacher(race).clamp(-LARGEST, LARGEST)
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
            falling = 1.0 - (1.0 - LAST_RATE) * update / count if last else 1.0
            optimizer.param_groups[0]["lr"] = self.learning_rate * falling
            chosen = torch.randint(0, len(seen), (self.batch,), generator=dice, device=seen.device)
            answer, target = network(seen.index_select(0, chosen)), asked.index_select(0, chosen)
            beyond = (target.abs() >= LARGEST) & (answer * target.sign() > LARGEST)
            loss = ((answer - target) ** 2).masked_fill(beyond, 0.0).mean()
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            losses.append(loss.detach())
        return float(torch.stack(losses).mean())
