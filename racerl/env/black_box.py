"""The black box: the last states and commands of all cars, kept for those whose simulation fails.

A failure is a table of up to `LENGTH` rows, one per control step of its episode: the car's number, the step (0 is the
one that failed), the state before it, the commands held in it, and the car's own parameters. `replay` drives it again.
"""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import pandas as pd
import torch
from torch import Tensor

from racerl.documents import write_parquet
from racerl.errors import RunError
from racerl.vehicle.vehicle import COMMAND

if TYPE_CHECKING:
    from racerl.env.race import Race

LENGTH = 50  # control steps
MOST = 16  # failures that are kept
FILE = "failed_cars.parquet"
PARAMETER = "parameter."  # in front of the names of drawn parameters


class BlackBox:
    """Remembers the last steps of N cars with states (S, N) of these names."""

    def __init__(self, names: Sequence[str]) -> None:
        self.names = names
        self.failures: list[pd.DataFrame] = []
        self._tape = torch.empty(0)  # until the first step: a GPU's race takes no notes
        self._steps = 0

    def note(self, state: Tensor, command: Tensor, age: Tensor) -> None:
        """Remember states (S, N) and commands (2, N) of the step that comes, of cars in their episodes' steps (N,)."""
        if not self._steps:
            self._tape = state.new_zeros(LENGTH, len(state) + len(command), state.shape[1])
        self._age = age
        row = self._tape[self._steps % LENGTH]
        row[: len(state)], row[len(state) :] = state, command
        self._steps += 1

    def keep(self, cars: Tensor, parameters: Mapping[str, Tensor]) -> None:
        """Keep what is remembered of this episode of the cars of these numbers, with their parameters, (N,) each."""
        for car in cars.tolist()[: MOST - len(self.failures)]:
            count = min(LENGTH, self._steps, int(self._age[car]) + 1)
            slots = [(self._steps - count + i) % LENGTH for i in range(count)]
            table = pd.DataFrame(self._tape[slots, :, car].cpu().numpy(), columns=[*self.names, *COMMAND])
            drawn = {f"{PARAMETER}{name}": float(values[car]) for name, values in parameters.items()}
            self.failures.append(table.assign(car=car, step=range(1 - count, 1), **drawn))


def read_failures(folder: Path) -> list[pd.DataFrame]:
    """Return the failures that a run's folder holds."""
    if not (folder / FILE).is_file():
        return []
    return [table for _, table in pd.read_parquet(folder / FILE).groupby("failure")]


def write_failures(folder: Path, races: Iterable["Race"], earlier: Sequence[pd.DataFrame] = ()) -> None:
    """Write the failures in some races into a run's folder, behind earlier ones; nothing where there was none."""
    failures = [*earlier, *(failure for race in races for failure in race.box.failures)]
    if failures:
        tables = [table.assign(failure=number) for number, table in enumerate(failures)]
        write_parquet(folder / FILE, pd.concat(tables, ignore_index=True))


def replay(race: "Race", failure: pd.DataFrame) -> Tensor:
    """Drive a failure again in a race of one car; return the states (K, S) from its first row to what came of its last.

    Where commands act late it begins behind the rows whose commands still act in the first step; RunError where there
    are no more. Parameters are those of the end: where they change from lap to lap (`dr.each_lap`), rows of the lap
    before come out otherwise.
    """
    names, late = list(race.vehicle.states), max(0, len(race.history) - 1)
    if len(failure) <= late:
        raise RunError(
            f"a failure of {len(failure)} steps: commands act up to {late} late, so it cannot be driven again"
        )
    rows = torch.tensor(failure[[*names, *COMMAND]].to_numpy(), dtype=race.dtype, device=race.device)
    drawn = [float(failure[f"{PARAMETER}{name}"].iloc[0]) for name in race.draws.names]
    race.draws.values = race.constant(drawn)[:, None]
    race.state = rows[late, : len(names), None]
    states = [race.state[:, 0]]
    commands = rows[:, len(names) :, None]
    for i in range(late, len(rows)):
        race.command = commands[i]
        race.history = commands[i - late : i + 1].flip(0) if late else race.history
        race.state = race.driven()
        states.append(race.state[:, 0])
    return torch.stack(states)
