"""The time-optimal lap as a row of its own: nobody drives it, it is the bound under everybody's laps."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pandas as pd

from racerl.control.controllers import Known, Rival
from racerl.errors import ConfigError
from racerl.optimum.kept import kept_lap
from racerl.optimum.optimum import trajectory

PERIOD = 0.01  # s
LAPS = 2.2  # so that one begins and ends at the line


@dataclass(frozen=True)
class Optimum:
    """The bound; it has no settings."""

    delay: ClassVar[float] = 0.0

    def prepare(self, known: Known) -> Rival:
        """Raise ConfigError: there is nothing to drive."""
        raise ConfigError("controller = optimum: is a lap, not a driver; racerl evaluate controller=optimum shows it")

    def lap(self, known: Known, on_share: Callable[[float], None] = lambda share: None) -> pd.DataFrame:
        """Return the lap, driven over and over, as the table of a log; raise OptimumError where none is found."""
        solution = kept_lap(known.vehicle, known.track, known.action, on_share)
        lap = trajectory(solution).set_index("t")[["x", "y", "yaw", "v_x", "v_y", "yaw_rate", "delta", "omega"]]
        t = np.arange(0.0, LAPS * solution.time, PERIOD)
        number, within = np.divmod(t, solution.time)
        first = lap.iloc[-1:].set_axis([0.0])
        closed = pd.concat([first.assign(yaw=first["yaw"] - solution.turn), lap])
        columns = {name: np.interp(within, closed.index, closed[name]) for name in closed}
        columns["yaw"] = columns["yaw"] + number * solution.turn
        return pd.DataFrame({"t": t, "run": 0, **columns})
