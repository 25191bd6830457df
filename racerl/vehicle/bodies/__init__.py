"""Bodies: cars whose equations are others' and not the single-track car's. They are driven, not fitted or optimised.

One module each, named as `vehicle.body` names it. Its class is built from the configured vehicle, of which it takes
what both have (wheelbase, mass, actuators); its own numbers stand in its file.
"""

import inspect
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from racerl import registry
from racerl.errors import VehicleError
from racerl.vehicle import bodies as package
from racerl.vehicle.effects import Effect
from racerl.vehicle.vehicle import Vehicle

OUTSIDE = ("delays", "measure", "latencies", "key")  # of an effect's hooks, those that no equation of motion calls
WITHIN = [
    name for name, hook in vars(Effect).items() if inspect.isfunction(hook) and name[0] != "_" and name not in OUTSIDE
]


class Body(Protocol):
    """A car of its own kind; `shown` is a state as STATE has it, (8,)."""

    def begin(self, shown: Sequence[float]) -> Any:
        """Return its own state in that motion, at rest on its springs."""

    def advance(self, own: Any, command: tuple[float, float], seconds: float) -> Any:
        """Return its own state after a command (delta_ref in rad, omega_ref in m/s) was held for so long."""

    def show(self, own: Any) -> list[float]:
        """Return the rows of STATE."""


def create_body(vehicle: Vehicle) -> Body:
    """Return the body that a vehicle names; raise ConfigError or VehicleError where it cannot be driven."""
    body: Body = registry.lookup(package, vehicle.body)(vehicle)
    for name, effect in vehicle.effects.items():
        if any(getattr(type(effect), hook) is not getattr(Effect, hook) for hook in WITHIN):
            raise VehicleError(
                f"vehicle.effects.{name} acts on the single-track car, not on body {vehicle.body}, which takes "
                "wheelbase, mass and actuators from the vehicle: give one without it, as vehicle=f1tenth"
            )
    return body


class BodyMotion:
    """The motion of N cars with a body; a car whose state is not the one it was left in begins anew in it."""

    name = "body"

    def __init__(self, vehicle: Vehicle, names: Sequence[str], seconds: float) -> None:
        if names:
            raise VehicleError(f"dr: {', '.join(names)} cannot be drawn for body {vehicle.body}; give dr=none")
        self.body, self.seconds = create_body(vehicle), seconds
        self._own: dict[int, Any] = {}  # by car
        self._left: dict[int, NDArray[Any]] = {}  # what it showed then, in the precision of the states

    def __call__(self, state: Tensor, command: Tensor, parameters: Tensor) -> Tensor:
        """Return the state (8, N) after one step with a command (2, N)."""
        columns = zip(state.T.numpy(), command.T.tolist(), strict=True)
        return torch.from_numpy(np.stack([self.advance(car, *each) for car, each in enumerate(columns)], axis=1))

    def advance(self, car: int, state: NDArray[Any], command: Sequence[float]) -> NDArray[Any]:
        """Return the state (8,) of one car after one step."""
        if car not in self._own or not np.array_equal(self._left[car], state):
            self._own[car] = self.body.begin(state.tolist())
        try:
            self._own[car] = self.body.advance(self._own[car], (command[0], command[1]), self.seconds)
        except (ArithmeticError, ValueError):  # its equations have no answer here: a failed car, as others fail
            del self._own[car]
            return np.full_like(state, np.nan)
        self._left[car] = np.array(self.body.show(self._own[car]), dtype=state.dtype)
        return self._left[car].copy()
