"""What a car's sensors add to the truth: white noise, one standard deviation per sensor."""

import math
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from racerl.errors import ConfigError

COLUMNS = ("x", "y", "yaw", "delta", "omega", "current")


@dataclass(frozen=True)
class Sensors:
    """Standard deviations of the measurements; `conf/car/*.yaml` says where the numbers come from."""

    position: float = 0.0005  # m, of x and of y
    yaw: float = 0.001  # rad
    delta: float = 0.002  # rad
    omega: float = 0.01  # m/s
    current: float = 0.2  # A

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0.0 <= value < math.inf:
                raise ConfigError(f"car.sensors.{field.name} = {value}: allowed is a standard deviation of at least 0")

    def noise(self, rows: int, generator: np.random.Generator) -> NDArray[np.float64]:
        """Draw the errors of `rows` measurements, shape (rows, 6), in the order of `COLUMNS`."""
        deviation = [self.position, self.position, self.yaw, self.delta, self.omega, self.current]
        return generator.standard_normal((rows, len(COLUMNS))) * np.array(deviation)
