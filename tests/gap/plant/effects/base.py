"""What an effect is, and the hooks by which it may change the plant.

An effect stands for a whole batch: `on` (B,) says which cars have it, `p[name]` (B,) holds its parameters. Cars without
it keep the value that came in, exactly. Every hook takes the moment `now` (see `car.Now`) and the value to change.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from tests.gap.plant.tyre import Array

if TYPE_CHECKING:
    from tests.gap.plant.car import Now, Plant

Steps = NDArray[np.integer]
SIZES = ("small", "medium", "large")
STEP = 1e-3  # s, of Heun's method
GRAVITY = 9.81  # m/s²


def three(**values: tuple[float, float, float] | float) -> dict[str, dict[str, float]]:
    """Parameter values of the three sizes; a single number holds for all of them."""
    return {
        size: {name: value[i] if isinstance(value, tuple) else value for name, value in values.items()}
        for i, size in enumerate(SIZES)
    }


class DelayLine:
    """An exact delay of whole time steps: read(lag) returns what was written `lag` steps before the newest."""

    def __init__(self, longest: int) -> None:
        self.length = longest + 1
        self.buffer = np.empty(0)
        self.head = 0

    def fill(self, value: Array) -> None:
        """Forget the past: the value has always been this."""
        self.buffer = np.repeat(value[None], self.length, axis=0)

    def write(self, value: Array) -> None:
        """Append the newest value."""
        self.head = (self.head + 1) % self.length
        self.buffer[self.head] = value

    def read(self, lag: Steps) -> Array:
        """The value of `lag` steps ago; lag has the value's shape."""
        return np.take_along_axis(self.buffer, ((self.head - lag) % self.length)[None], axis=0)[0]


class Effect:
    """A way in which the real car differs from the nominal model."""

    name: ClassVar[str] = ""
    units: ClassVar[dict[str, str]] = {}
    sizes: ClassVar[dict[str, dict[str, float]]] = {}
    signed: ClassVar[tuple[str, ...]] = ()  # parameters whose sign each case draws
    fixed: ClassVar[tuple[str, ...]] = ()  # parameters that a case does not vary about the size's value
    persists: ClassVar[bool] = False  # do its states outlive a run?

    def __init__(self, on: Array, values: dict[str, Array]) -> None:
        self.on = np.asarray(on, bool)
        self.gate = self.on.astype(float)
        self.p = values
        self.rows = slice(0, 0)
        self.dt = STEP

    def pick(self, new: Array, old: Array) -> Array:
        """The new value where the effect is on, else the old one."""
        return np.where(self.on, new, old)

    # set-up
    def reshape(self, cars: dict[str, Array]) -> None:
        """Change the cars' own parameters before anything is built from them."""

    def attach(self, plant: Plant) -> None:
        """Take what it needs of the plant: the cars, the wheels, the ground."""

    def n_states(self, n_wheels: int) -> int:
        """How many rows of the state it integrates."""
        return 0

    # between and within runs
    def begin(self, now: Now, command: Array) -> None:
        """A run starts with this command held: reset the memory."""

    def rest(self, state: Array, seconds: float) -> None:
        """The car stands still between two runs; `state` are the effect's own rows, to change in place."""

    def tick(self, now: Now) -> None:
        """Update discrete memory; called once before every time step."""

    # hooks, in the order in which they are called
    def command(self, now: Now, command: Array) -> Array:
        """δ_ref and ω_ref as they reach the actuators, (2, B); called once per time step."""
        return command

    def road_wheel(self, now: Now, angle: Array) -> Array:
        """Angle of the front wheels on the road, rad, (B,)."""
        return angle

    def surface(self, now: Now, speed: Array) -> Array:
        """Surface speed of each wheel, m/s, (W, B)."""
        return speed

    def loads(self, now: Now, load: Array) -> Array:
        """Vertical load of each wheel, N, (W, B)."""
        return load

    def grip(self, now: Now, friction: Array) -> Array:
        """Friction factor of each wheel, (W, B)."""
        return friction

    def forces(self, now: Now, force: Array) -> Array:
        """F_x and F_y of each wheel in the wheel's frame, N, (2, W, B); may be changed in place."""
        return force

    def body(self, now: Now, wrench: Array) -> Array:
        """F_x, F_y in N and M_z in N m on the body at the CoG in the car's frame, (3, B); may be changed in place."""
        return wrench

    def servo(self, now: Now, rate: Array) -> Array:
        """Rate of δ, rad/s, (B,)."""
        return rate

    def motor(self, now: Now, rate: Array) -> Array:
        """Rate of ω, m/s², (B,)."""
        return rate

    def rates(self, now: Now) -> Array | float:
        """Rates of the effect's own states, (n_states, B)."""
        return 0.0

    # the log
    def lag(self) -> dict[str, Array]:
        """Seconds by which groups of logged channels are late: pose, delta, omega, command, each (B,)."""
        return {}

    def read(self, log: dict[str, Array]) -> None:
        """Change the logged columns, each (n, B), in place."""

    def own(self, now: Now) -> Array:
        """Its own states, (n_states, B)."""
        return now.state[self.rows]
