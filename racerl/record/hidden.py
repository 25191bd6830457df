"""Hidden cars: vehicles whose parameters are drawn around the configured ones, to be recovered from their logs."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from racerl import bounds
from racerl.errors import ConfigError
from racerl.vehicle.parameter import matching, specifications, values
from racerl.vehicle.vehicle import Vehicle


@dataclass(frozen=True)
class Hidden:
    """Each chosen parameter is multiplied by a draw from U(1 − spread, 1 + spread), inside its physical bounds."""

    spread: float = 0.0
    seed: int = 0
    parameters: Sequence[str] = ()

    def __post_init__(self) -> None:
        if isinstance(self.spread, bool) or not isinstance(self.spread, (int, float)) or not 0.0 <= self.spread < 1.0:
            raise ConfigError(f"hidden.spread = {self.spread}: allowed is 0 … 1 (a share of each value)")
        bounds.whole("hidden.seed", self.seed, 0, 2**63 - 1)
        if isinstance(self.parameters, str) or not all(isinstance(name, str) for name in self.parameters):
            raise ConfigError(f"hidden.parameters = {self.parameters}: a list of names or patterns is expected")

    def draw(self, vehicle: Vehicle) -> dict[str, float]:
        """Return the drawn values by dotted name; none without a spread."""
        if self.spread == 0.0:
            return {}
        known, bounds = values(vehicle), specifications(vehicle)
        generator = np.random.default_rng(self.seed)
        drawn = {}
        for name in matching(self.parameters, known, "hidden.parameters"):
            value = float(known[name]) * generator.uniform(1.0 - self.spread, 1.0 + self.spread)
            drawn[name] = float(np.clip(value, bounds[name].low, bounds[name].high))
        return drawn
