"""The cars that a policy drives while it is improved: from whose states it is tried, and where they start."""

from typing import Protocol

import torch
from torch import Tensor

from racerl.control.networks import forgotten
from racerl.control.policy import AnyPolicy
from racerl.env.race import Race
from racerl.env.races import Races
from racerl.train.checkpoint import section


class Rhythm(Protocol):
    """How long they drive; `conf/budget/*.yaml` says what each number is."""

    @property
    def between(self) -> int:
        """Control steps between two looks at them."""

    @property
    def episode(self) -> int:
        """Control steps until a car starts anew."""

    @property
    def again(self) -> float:
        """Chance that a crashed car starts from where it had."""


class Practice:
    """The cars that the policy drives between two steps of its weights, from whose states it is tried.

    A car starts anew when its episode is over, and after a crash, then mostly from where it had started.
    """

    def __init__(self, race: Race | Races, policy: AnyPolicy, settings: Rhythm, dice: torch.Generator) -> None:
        self.race, self.policy, self.settings, self.dice = race, policy, settings, dice
        self.memory = torch.zeros(race.count, policy.units, device=race.device)
        # episodes end one after the other
        race.age = torch.arange(race.count, device=race.device) * settings.episode // race.count
        self.starts, self.commands = race.state.clone(), race.command.clone()

    def drive(self) -> None:
        """Drive for a while; cars whose episode is over then stand at their next start."""
        for _ in range(self.settings.between):
            action, memory = self.policy.decide(self.race.observe(), self.memory)
            crashed = self.race.step(action).terminated
            self.memory = forgotten(memory, crashed)
            self._return(crashed)
        over = self.race.age >= self.settings.episode
        self.race.restart(over)
        self.memory = forgotten(self.memory, over)
        self._remember(over)

    def _return(self, crashed: Tensor) -> None:
        """Put crashed cars, which stand at new starts, back to where they had started, but for a few."""
        if not bool(crashed.any()):
            return
        again = torch.rand(self.race.count, generator=self.dice, device=self.race.device) < self.settings.again
        self._remember(crashed & ~again)
        cars = (crashed & again).nonzero()[:, 0]
        self.race.put(cars, self.starts[:, cars], self.commands[:, cars])

    def _remember(self, cars: Tensor) -> None:
        self.starts = torch.where(cars, self.race.state, self.starts)
        self.commands = torch.where(cars, self.race.command, self.commands)

    def copy_into(self, race: Race | Races) -> None:
        """Put the cars of a race, as many or a multiple, where these stand, at the first step of an episode."""
        kept = {**self.race.snapshot(), "age": torch.zeros_like(self.race.age)}
        times = race.count // self.race.count
        copies = {name: torch.cat([rows] * times, dim=-1) for name, rows in kept.items() if name != "dice"}
        race.restore({**copies, "dice": race.dice.snapshot()})

    def snapshot(self) -> dict[str, Tensor]:
        """Return all that what it does next depends on: cars, dice and the policy's weights."""
        tensors = {f"network.{name}": tensor for name, tensor in self.policy.network.state_dict().items()}
        cars = {"starts": self.starts, "start_commands": self.commands, "memory": self.memory, **self.race.snapshot()}
        return tensors | {f"lead.{name}": tensor for name, tensor in cars.items()} | {"dice": self.dice.get_state()}

    def restore(self, tensors: dict[str, Tensor]) -> None:
        """Go on from a snapshot."""
        self.policy.network.load_state_dict(section(tensors, "network."))
        cars, names = section(tensors, "lead."), ("starts", "start_commands", "memory")
        self.starts, self.commands, self.memory = (cars.pop(name).to(self.race.device) for name in names)
        self.race.restore(cars)
        self.dice.set_state(tensors["dice"])
