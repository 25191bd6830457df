"""Pure pursuit of a raceline: the car steers along the arc through a point of the line some way ahead.

With α the angle of that point off the car's axis, a distance d away from the rear axle:  δ = atan(2 L sin α/d). The
speed is a share of the line's own, a little ahead. A time-optimal line is driven sliding; geometry does not slide, so
that the share is well below 1.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from racerl import bounds
from racerl.control.controllers import Known
from racerl.env.actions import outputs
from racerl.env.race import V_X, YAW, Race, X, Y
from racerl.errors import ConfigError, TrackError
from racerl.optimum.kept import kept_lap
from racerl.optimum.optimum import trajectory
from racerl.track.curve import arc_length
from racerl.track.raceline import read_raceline

SPACING = 0.02  # m

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PurePursuit:
    """The controller's settings."""

    # least and greatest of what racerl tune looks for
    SEARCH: ClassVar[dict[str, tuple[float, float]]] = {
        "speed": (0.3, 1.2),
        "ahead": (0.1, 1.0),
        "ahead_time": (0.01, 0.5),
        "preview": (0.01, 0.5),
    }
    speed: float  # share of the line's speed
    ahead: float  # m, to the point that is steered for, and
    ahead_time: float  # s, more with speed
    preview: float  # s ahead of the car, where the speed is taken from
    raceline: str | None = None  # in the TUM format; the time-optimal lap where there is none
    delay: float = 0.0  # s

    def __post_init__(self) -> None:
        ranges = {"speed": (0.05, 2.0), "ahead": (0.05, 10.0), "ahead_time": (0.0, 3.0), "preview": (0.0, 3.0)}
        for name, (low, high) in {**ranges, "delay": (0.0, 0.2)}.items():
            bounds.number(f"controller.{name}", getattr(self, name), low, high)
        if self.raceline is not None and not isinstance(self.raceline, str):
            raise ConfigError(f"controller.raceline = {self.raceline}: the path of a file is expected")

    def prepare(self, known: Known) -> "Pursuer":
        """Return the controller for a car and its track."""
        if known.action.drive_mode != "wheel_speed":
            raise ConfigError(
                f"controller = pure_pursuit: commands wheel speeds, not {known.action.drive_mode}; use sim=default"
            )
        return Pursuer(self, known, _read(Path(self.raceline)) if self.raceline else _time_optimal(known))


class Pursuer:
    """The controller at work on a line of x, y in m and speed in m/s, (3, M)."""

    name = "pure pursuit"
    facts: ClassVar[dict[str, float]] = {}

    def __init__(self, settings: PurePursuit, known: Known, line: Array) -> None:
        self.settings, self.known = settings, known
        closed = np.column_stack([line, line[:, :1]])
        s = arc_length(closed[:2].T)
        count = round(s[-1] / SPACING)
        even = np.stack([np.interp(np.arange(count) * (s[-1] / count), s, row) for row in closed])
        self._x, self._y, self._speed = torch.tensor(even, dtype=torch.float32)
        self._spacing = float(s[-1]) / count

    def act(self, race: Race) -> Tensor:
        """Return the actions for the cars of a race."""
        state, _ = race.seen()
        x, y, yaw, speed = state[X], state[Y], state[YAW], state[V_X].clamp(min=0.0)
        axle_x, axle_y = (x - self.known.vehicle.l_r * torch.cos(yaw), y - self.known.vehicle.l_r * torch.sin(yaw))
        nearest = ((x[:, None] - self._x) ** 2 + (y[:, None] - self._y) ** 2).argmin(dim=1)
        aim = self._after(nearest, self.settings.ahead + self.settings.ahead_time * speed)
        dx, dy = self._x[aim] - axle_x, self._y[aim] - axle_y
        off_axis = torch.atan2(dy, dx) - yaw
        steering = torch.atan2(2.0 * self.known.vehicle.wheelbase * torch.sin(off_axis), torch.hypot(dx, dy))
        wanted = self.settings.speed * self._speed[self._after(nearest, self.settings.preview * speed)]
        action = outputs(race.action, steering, wanted, race.command[1], race.timing.dt)
        return torch.stack(action, dim=1).clamp(-1.0, 1.0)

    def _after(self, index: Tensor, way: Tensor) -> Tensor:
        """Return the points some way in m after others, round the lap."""
        found: Tensor = (index + (way / self._spacing).round().long()) % len(self._x)
        return found


def _time_optimal(known: Known) -> Array:
    lap = trajectory(kept_lap(known.vehicle, known.track, known.action))
    return np.stack([lap["x"], lap["y"], np.hypot(lap["v_x"], lap["v_y"])])


def _read(path: Path) -> Array:
    """Return x, y and speed of a raceline in the TUM format; raise ConfigError for anything else."""
    try:
        line = read_raceline(path)
    except TrackError as error:
        raise ConfigError(f"controller.raceline = {error}") from error
    return np.stack([line["x_m"], line["y_m"], line["vx_mps"]])
