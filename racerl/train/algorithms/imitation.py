"""Imitation of a teacher that knows the car (DAgger): the policy drives, the teacher says what it would have done.

All that was ever seen is kept and fitted again after every round, so that the policy learns to come back from its own
mistakes. Targets reach a little beyond ± 1, where the race clamps; a network that is further out on the same side is
not pulled back.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor, nn

from racerl import bounds
from racerl.assemble import unlimited
from racerl.control.networks import build_network
from racerl.env.race import Race
from racerl.train import checkpoint
from racerl.train.checkpoint import load_optimizer, optimizer_tensors, section
from racerl.train.products import fast_products
from racerl.train.session import Progress, Session, policy_of, require_finite_weights
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


@dataclass
class Lessons:
    """An imitation in its course: the cars, the network and its optimizer, and all that was seen and asked so far."""

    race: Race
    network: nn.Sequential
    optimizer: torch.optim.Optimizer
    dice: torch.Generator
    rounds: int = 0
    seen: list[Tensor] = field(default_factory=list)
    asked: list[Tensor] = field(default_factory=list)

    def snapshot(self) -> dict[str, Tensor]:
        """Return all that the next round depends on, but for its number."""
        tensors = {f"network.{name}": tensor for name, tensor in self.network.state_dict().items()}
        tensors |= {f"optimizer.{name}": tensor for name, tensor in optimizer_tensors(self.optimizer).items()}
        tensors |= {f"race.{name}": tensor for name, tensor in self.race.snapshot().items()}
        return tensors | {"dice": self.dice.get_state(), "seen": torch.cat(self.seen), "asked": torch.cat(self.asked)}

    def restore(self, tensors: dict[str, Tensor], state: Mapping[str, Any]) -> None:
        """Go on from a snapshot."""
        self.network.load_state_dict(section(tensors, "network."))
        load_optimizer(self.optimizer, section(tensors, "optimizer."))
        self.race.restore(section(tensors, "race."))
        self.dice.set_state(tensors["dice"])
        self.seen, self.asked = ([tensors[name].to(self.race.device)] for name in ("seen", "asked"))
        self.rounds, self.race.faults = state["rounds"], state["faults"]


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

        race = session.build_race(self.cars)
        session.start()
        # a lap at the limit is beyond a car with less grip, however good its feedback: trials are of the plain car
        plain = unlimited({**session.settings, "dr": {"sigma": 0.0, "parameters": []}})
        teacher = find_teacher(lambda: session.build_race(self.cars, plain))
        torch.manual_seed(session.seed)
        network = build_network([race.observation.size, *self.layers, 2]).to(session.device)
        optimizer = torch.optim.Adam(network.parameters(), self.learning_rate)
        dice = torch.Generator(session.device).manual_seed(session.seed)
        lessons = Lessons(race, network, optimizer, dice)
        path = session.folder.path / checkpoint.FILE
        state = checkpoint.recover(path, lessons.restore)
        session.recall(state, lessons.rounds * self.cars * self.steps)
        if state is None:
            self._start_fast(race, teacher, race.age == 0, dice)

        def keep() -> None:
            facts = {"rounds": lessons.rounds, "faults": race.faults, "session": session.facts()}
            checkpoint.keep(path, lessons.snapshot(), facts)

        total = self.rounds * self.cars * self.steps
        with session.kept(keep) as between:
            while lessons.rounds < self.rounds:
                reward = self._drive(lessons, teacher)
                last = lessons.rounds == self.rounds - 1
                with fast_products(session.device):
                    loss = self._fit(lessons, last)
                lessons.rounds += 1
                steps = lessons.rounds * self.cars * self.steps
                require_finite_weights({"policy": network.parameters()}, steps, "lower algo.learning_rate")
                if last or lessons.rounds % self.examined_every == 0:
                    # two laps from a slow start say little of the pace: the policy that has seen most is kept
                    session.examine(policy_of(network, race, session.settings), steps, improving=True)
                session.logger.record("train/loss", loss)
                session.logger.record("train/reward", reward)
                session.logger.dump(steps)
                between()
                rate = steps / session.seconds
                session.on_progress(Progress(steps, total, session.seconds, rate, reward, session.last))
        return {"steps": total, "nan_cars": race.faults}

    @torch.no_grad()
    def _drive(self, lessons: Lessons, teacher: Teacher) -> float:
        """Drive all cars, fewer and fewer of them by the teacher; keep what was seen; return the mean reward."""
        race, dice = lessons.race, lessons.dice
        taught = 1.0 - lessons.rounds / self.handing_over
        by_teacher = (torch.rand(race.count, generator=dice, device=race.device) < taught)[:, None]
        rewards = []
        observation = race.observe()
        for _ in range(self.steps):
            target = teacher(race).clamp(-self.largest_target, self.largest_target)
            lessons.seen.append(observation)
            lessons.asked.append(target)
            action = torch.where(by_teacher, target, lessons.network(observation)).clamp(-1.0, 1.0)
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

    def _fit(self, lessons: Lessons, last: bool) -> float:
        """Fit the network to all that was asked of it; return the mean loss."""
        network, optimizer, dice = lessons.network, lessons.optimizer, lessons.dice
        seen, asked = torch.cat(lessons.seen), torch.cat(lessons.asked)
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
