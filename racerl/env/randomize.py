"""Domain randomization: at each episode start every chosen parameter is multiplied by a draw from N(1, σ).

With `each_lap` it is drawn anew at every crossing of the line, too: a floor and tyres that change from lap to lap.

Parameters are chosen by dotted name or pattern (`friction`, `*.p_Ky1`). Draws are kept inside the physical bounds.
`cars` names a run whose cars are drawn from: what `racerl identify` or `racerl gap` leaves possible, whole cars, so
that what is correlated stays so. What else is chosen is multiplied on top.

Noise, of what the driver sees and of what it does, is drawn at every control step.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from racerl import bounds
from racerl.env.chosen import Chosen
from racerl.env.dice import Dice
from racerl.env.sensing import check_estimate
from racerl.errors import ConfigError, suggest
from racerl.vehicle.cars import read_cars
from racerl.vehicle.parameter import matching, specifications, values
from racerl.vehicle.vehicle import Vehicle

LEAST_SPREAD = 1e-3  # share of a parameter, as whose standard deviation any counts at least
FARTHEST = 10.0  # standard deviations, that a critic is told of


@dataclass(frozen=True)
class Randomization:
    """Which parameters vary, and by how much."""

    sigma: float = 0.0
    parameters: Sequence[str] = ()
    each_lap: bool = False
    estimate: Mapping[str, float] = field(default_factory=dict)  # noise of what the driver sees, deviation per state
    actions: float = 0.0  # noise of the actions, deviation in their scale of ± 1
    cars: str = ""  # a run of racerl identify or racerl gap, whose cars are drawn from

    def __post_init__(self) -> None:
        check_estimate("dr.estimate", self.estimate)
        bounds.number("dr.actions", self.actions, 0.0, 1.0)
        bounds.switch("dr.each_lap", self.each_lap)
        if not isinstance(self.sigma, (int, float)) or not 0.0 <= self.sigma <= 1.0:
            raise ConfigError(f"dr.sigma = {self.sigma}: allowed is 0 … 1 (a share of each value)")
        if not isinstance(self.cars, str) or "\0" in self.cars:
            raise ConfigError(f"dr.cars = {self.cars!r}: a run folder is expected, as in dr=posterior:RUN")
        if not isinstance(self.parameters, list | tuple) or not all(isinstance(name, str) for name in self.parameters):
            raise ConfigError(f"dr.parameters = {self.parameters}: a list of parameter names or patterns is expected")
        if self.sigma > 0 and not self.parameters:
            cure = f"dr.parameters=[friction], or dr=friction_0.02 dr.sigma={self.sigma:g}"
            raise ConfigError(f"dr.sigma = {self.sigma}: no parameter is to spread by that; give {cure}")

    def names(self, vehicle: Vehicle) -> list[str]:
        """Return the dotted names that the patterns stand for; raise ConfigError when one matches nothing."""
        known = values(vehicle)
        names = dict.fromkeys(matching(self.parameters, known, "dr.parameters"))
        return [name for name in names if known[name] != 0.0]


class ParameterDraws:
    """The randomized parameters of N cars, one row each, drawn anew for cars that start over."""

    def __init__(
        self, vehicle: Vehicle, randomization: Randomization, count: int, device: torch.device, dtype: torch.dtype
    ) -> None:
        matched = randomization.names(vehicle)
        scaled = matched if randomization.sigma > 0 else []
        possible = read_cars(Path(randomization.cars), vehicle) if randomization.cars else {}
        self.names = [*possible, *(name for name in scaled if name not in possible)]
        self._known = nominal = values(vehicle)
        bounds = specifications(vehicle)

        def column(numbers: Sequence[float]) -> Tensor:
            return torch.tensor(numbers, device=device, dtype=dtype)[:, None]

        self._nominal = column([float(nominal[name]) for name in self.names])
        self._low = column([bounds[name].low for name in self.names])
        self._high = column([bounds[name].high for name in self.names])
        self._sigma = column([randomization.sigma * (name in scaled) for name in self.names])
        table = np.array(list(possible.values()))
        self._cars = torch.tensor(table, device=device, dtype=dtype) if possible else None  # (Q, K)
        self.values = self._nominal.expand(-1, count).clone()  # (P, N)
        self._middle, variance = self._nominal.clone(), (self._sigma * self._nominal) ** 2
        if self._cars is not None:
            self._middle[: len(possible)] = self._cars.mean(dim=1, keepdim=True)
            variance[: len(possible)] += self._cars.var(dim=1, correction=0, keepdim=True)
        self._spread = torch.maximum(variance.sqrt(), LEAST_SPREAD * self._middle.abs().clamp(min=LEAST_SPREAD))

    def privileged(self) -> Tensor:
        """Return how far each car's parameters lie from the middle of all, in standard deviations, (N, P)."""
        shares = (self.values - self._middle) / self._spread
        return shares.clamp(-FARTHEST, FARTHEST).T

    def off(self, names: Sequence[str], chosen: Chosen | None = None) -> Tensor:
        """Return by which shares parameters of all cars, or of some, differ from the vehicle's own, (N, P).

        Raises ConfigError for a name that is none of the vehicle's.
        """
        for name in names:
            if name not in self._known:
                raise ConfigError(f"obs.parameters: the vehicle has no '{name}'{suggest(name, self._known)}")
        drawn = self.values if chosen is None else chosen.take(self.values)
        shares = dict(zip(self.names, drawn / self._nominal - 1.0, strict=True))
        as_modelled = drawn.new_zeros(drawn.shape[1])
        return torch.stack([shares.get(name, as_modelled) for name in names], dim=1)

    def draw(self, chosen: Chosen, dice: Dice) -> None:
        """Draw new parameters for some cars."""
        cars = chosen.cars
        if not self.names or not len(cars):
            return
        base = self._nominal
        if self._cars is not None:
            which = (dice.uniform(1, cars)[0] * self._cars.shape[1]).long()
            base = torch.cat([self._cars[:, which], base[len(self._cars) :].expand(-1, len(cars))])
        noise = dice.normal(len(self.names), cars)
        fresh = (base * (1.0 + self._sigma * noise)).clamp(self._low, self._high)
        self.values = chosen.put(self.values, fresh)
