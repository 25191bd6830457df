"""What the pedal means: the second number of the race's action, by the drive mode of `sim`.

`WheelSpeed`    the rate of the wheel speed, as the action `speed_rate` has it: released, the car keeps its speed.
`MotorCurrent`  a share of the current limit, which the driver may change. As a motor controller's, the braking current
                fades while the wheels come to a stop, so that they are never driven backwards.
"""

from typing import Protocol

from racerl.env.race import Race
from racerl.vehicle.actuator import MotorCurrent as Motor

STEP = 5.0  # A, by which a key changes the limit; the least limit too
FADE = 0.5  # m/s of wheel speed below which the braking current fades


class Pedal(Protocol):
    """Turns a pedal in −1 … 1 into the action's second number."""

    @property
    def text(self) -> str:
        """What the window says of the mode."""

    def drive(self, pedal: float, omega: float) -> float:
        """Return the number in −1 … 1, at a wheel speed in m/s."""

    def adjust(self, steps: int) -> None:
        """Raise or lower the limit by so many steps."""


def create_pedal(race: Race, current_limit: float) -> Pedal:
    """Return the pedal of the race's drive mode; `current_limit` in A is where a limit begins."""
    if isinstance(race.vehicle.drive, Motor):
        return MotorCurrent(current_limit, float(race.vehicle.drive.current_limit), race.action.drive_max)
    return WheelSpeed()


class WheelSpeed:
    """The pedal is the rate of the wheel speed."""

    text = "wheel speed"

    def drive(self, pedal: float, omega: float) -> float:
        """Return the pedal itself."""
        return pedal

    def adjust(self, steps: int) -> None:
        """Leave everything: there is no limit."""


class MotorCurrent:
    """The pedal is a share of the current limit."""

    def __init__(self, limit: float, motor: float, scale: float) -> None:
        self.greatest = min(motor, scale)  # A
        self.limit = min(limit, self.greatest)  # A
        self._scale = scale  # A of an action of 1

    @property
    def text(self) -> str:
        """What the window says of the mode."""
        return f"motor current, limit {self.limit:g} of {self.greatest:g} A"

    def drive(self, pedal: float, omega: float) -> float:
        """Return pedal · limit over the action's scale; brakes fade with ω."""
        grip = 1.0 if pedal >= 0.0 else min(max(omega / FADE, 0.0), 1.0)
        return grip * pedal * self.limit / self._scale

    def adjust(self, steps: int) -> None:
        """Change the limit inside STEP … the motor's."""
        self.limit = min(max(self.limit + steps * STEP, min(STEP, self.limit)), self.greatest)
