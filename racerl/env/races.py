"""Several races driven as one, so that one policy learns on several tracks.

The cars of the first race come first, then those of the second, and so on; each keeps its own track, draws and dice.
What is here is what training needs of a race, with the same names.
"""

from collections.abc import Iterator, Sequence

import torch
from torch import Tensor

from racerl.env.race import KEPT, Race, Step

SEED_STEP = 1_000_003  # between the seeds of two of the races
KEPT_OF_CARS = (*KEPT, "parameters")  # of a snapshot: what has a column for every car


class Dices:
    """The dice of several races."""

    def __init__(self, races: Sequence[Race]) -> None:
        self.races = races

    def snapshot(self) -> Tensor:
        """Return the state of all generators, (G, bytes)."""
        return torch.cat([race.dice.snapshot() for race in self.races])

    def restore(self, states: Tensor) -> None:
        """Continue from a snapshot."""
        for race, own in zip(self.races, states.split([len(race.seeds) for race in self.races]), strict=True):
            race.dice.restore(own)


class Races:
    """N cars in several races that have the same observation and action."""

    def __init__(self, races: Sequence[Race]) -> None:
        first = races[0]
        self.races = tuple(races)
        self.observation, self.action, self.timing = first.observation, first.action, first.timing
        self.device, self.waits = first.device, first.waits
        self.counts = [race.count for race in races]
        self.count = sum(self.counts)
        self.dice = Dices(races)

    @property
    def state(self) -> Tensor:
        """States (S, N)."""
        return torch.cat([race.state for race in self.races], dim=-1)

    @property
    def command(self) -> Tensor:
        """Commands (2, N)."""
        return torch.cat([race.command for race in self.races], dim=-1)

    @property
    def age(self) -> Tensor:
        """Control steps of each car's episode, (N,)."""
        return torch.cat([race.age for race in self.races])

    @age.setter
    def age(self, steps: Tensor) -> None:
        for race, own in self._each(steps):
            race.age = own

    @property
    def faults(self) -> int:
        """Simulations that failed so far."""
        return sum(race.faults for race in self.races)

    @faults.setter
    def faults(self, count: int) -> None:
        for race, own in zip(self.races, [count, *[0] * (len(self.races) - 1)], strict=True):
            race.faults = own

    def reset(self) -> Tensor:
        """Start all cars over; return the observation (N, O)."""
        return torch.cat([race.reset() for race in self.races])

    def reseed(self, seeds: Sequence[int]) -> None:
        """Use one new seed for all races from the next restart on."""
        (seed,) = seeds
        for number, race in enumerate(self.races):
            race.reseed([seed + SEED_STEP * number])

    def privileged(self) -> Tensor:
        """Return what is drawn of each car, in standard deviations, (N, P)."""
        return torch.cat([race.privileged() for race in self.races])

    def observe(self) -> Tensor:
        """Return the observation (N, O)."""
        return torch.cat([race.observe() for race in self.races])

    def step(self, action: Tensor) -> Step:
        """Drive all cars for one control step with actions (N, 2)."""
        steps = [race.step(own) for race, own in zip(self.races, action.split(self.counts), strict=True)]
        columns = ("command",)  # (2, N); all others have a row for every car
        return Step(
            *(
                torch.cat(parts, dim=-1 if name in columns else 0)
                for name, parts in zip(Step._fields, zip(*steps, strict=True), strict=True)
            )
        )

    def drive_on(self, action: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Drive all cars for one control step, differentiably: progress, clearance and who would end, (N,) each."""
        found = [race.drive_on(own) for race, own in zip(self.races, action.split(self.counts), strict=True)]
        progress, clear, ended = (torch.cat(parts) for parts in zip(*found, strict=True))
        return progress, clear, ended

    def restart(self, mask: Tensor) -> None:
        """Start the masked cars (N,) over."""
        for race, own in self._each(mask):
            race.restart(own)

    def put(self, cars: Tensor, state: Tensor, command: Tensor) -> None:
        """Begin the episodes of the cars of these numbers (K,) in states (S, K), with commands (2, K) behind them."""
        first = 0
        for race in self.races:
            here = (cars >= first) & (cars < first + race.count)
            race.put(cars[here] - first, state[:, here], command[:, here])
            first += race.count

    def snapshot(self) -> dict[str, Tensor]:
        """Return everything that the next step depends on, as tensors."""
        kept = [race.snapshot() for race in self.races]
        tables = {name: torch.cat([each[name] for each in kept], dim=-1) for name in KEPT_OF_CARS}
        return {**tables, "dice": self.dice.snapshot()}

    def restore(self, kept: dict[str, Tensor]) -> None:
        """Continue from a snapshot."""
        self.dice.restore(kept["dice"])
        tables = {name: kept[name].split(self.counts, dim=-1) for name in KEPT_OF_CARS}
        for i, race in enumerate(self.races):
            race.restore({name: parts[i] for name, parts in tables.items()} | {"dice": race.dice.snapshot()})

    def _each(self, rows: Tensor) -> Iterator[tuple[Race, Tensor]]:
        return zip(self.races, rows.split(self.counts), strict=True)
