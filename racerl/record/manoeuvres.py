"""What an excitation programme is made of: short, open-loop pieces of driving, each with one question to the car.

Every manoeuvre is a frozen dataclass: it is approached straight ahead at `speed`, lasts `seconds` and turns to the side
`turn` (1 left, −1 right, 0 along the floor) on about `radius` metres. Angles in rad, speeds in m/s, times in s.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from racerl.record.drivers import Measured
from racerl.record.floor import REACTION, TRUSTED, Limits

CHIRP = (0.3, 5.0)  # Hz, from and to
Near = Callable[[float], float]  # a number close to the given one


@dataclass(frozen=True, kw_only=True)
class Manoeuvre:
    """The common part; a subclass says what is commanded."""

    speed: float
    seconds: float
    turn: int = 0
    radius: float = 0.0

    @property
    def kind(self) -> str:
        """Name in the log: the class's, in lower case with underscores."""
        return "".join(f"_{c.lower()}" if c.isupper() else c for c in type(self).__name__).lstrip("_")

    @property
    def pace(self) -> float:
        """Speed in m/s that is reckoned with when room is sought."""
        return self.speed

    def commands(self, t: float, car: Measured) -> tuple[float, float]:
        """Return (delta_ref, omega_ref) at t s after the start."""
        raise NotImplementedError


@dataclass(frozen=True, kw_only=True)
class CoastDown(Manoeuvre):
    """Let the wheel speed sink steadily: resistance, small slips, straight running."""

    rate: float  # m/s²

    def commands(self, t: float, car: Measured) -> tuple[float, float]:
        """Hold the steering straight."""
        return 0.0, max(0.0, self.speed - self.rate * t)


@dataclass(frozen=True, kw_only=True)
class AccelerationStaircase(Manoeuvre):
    """Climb to `top` in steps and down again: drive dynamics up and down, steady speeds."""

    top: float
    steps: int

    @property
    def pace(self) -> float:
        """Take the mean of the speeds."""
        return 0.5 * (self.speed + self.top)

    def commands(self, t: float, car: Measured) -> tuple[float, float]:
        """Return the step that t lies in."""
        step = min(int(t / self.seconds * 2 * self.steps), 2 * self.steps - 1)
        height = step + 1 if step < self.steps else 2 * self.steps - 1 - step
        return 0.0, self.speed + (self.top - self.speed) * height / self.steps


@dataclass(frozen=True, kw_only=True)
class LaunchAndBrake(Manoeuvre):
    """Ask for `top` at once, then for standstill: the whole range of slip ratios."""

    top: float
    hold: float

    @property
    def pace(self) -> float:
        """Take the mean of the speeds."""
        return 0.5 * (self.speed + self.top)

    def commands(self, t: float, car: Measured) -> tuple[float, float]:
        """Step up, step down."""
        return 0.0, self.top if t < self.hold else 0.0


@dataclass(frozen=True, kw_only=True)
class SlipRamp(Manoeuvre):
    """Sweep the slip ratio up to `slip`, then down to −`slip`, by keeping the wheels ahead of the car or behind it."""

    slip: float
    angle: float = 0.0

    def commands(self, t: float, car: Measured) -> tuple[float, float]:
        """Follow the measured speed with a slip that goes 0, +, 0, −."""
        slip = self.slip * math.sin(2.0 * math.pi * t / self.seconds)
        return self.angle * self.turn, max(car.v_x, 0.3) * (1.0 + slip)


@dataclass(frozen=True, kw_only=True)
class StepSteer(Manoeuvre):
    """Steer at once by `angle`: steering dynamics, lateral transients."""

    angle: float

    def commands(self, t: float, car: Measured) -> tuple[float, float]:
        """Straight for a moment, then the step."""
        return (self.turn * self.angle if t > 0.1 else 0.0), self.speed


@dataclass(frozen=True, kw_only=True)
class RampToLock(Manoeuvre):
    """Turn the steering slowly to `angle`, hold it and come back: the tyre curve, steering gain and its end."""

    angle: float

    def commands(self, t: float, car: Measured) -> tuple[float, float]:
        """Up for half of the time, held for a quarter, back for a quarter."""
        share = min(2.0 * t / self.seconds, 1.0, max(0.0, 4.0 * (1.0 - t / self.seconds)))
        return self.turn * self.angle * share, self.speed


@dataclass(frozen=True, kw_only=True)
class SteeringChirp(Manoeuvre):
    """Swing the steering about `middle`, faster and faster, or slower and slower."""

    middle: float
    angle: float
    falling: bool

    def commands(self, t: float, car: Measured) -> tuple[float, float]:
        """Add a sine of sweeping frequency."""
        return self.turn * self.middle + self.angle * chirp(t, self.seconds, self.falling), self.speed


@dataclass(frozen=True, kw_only=True)
class SpeedChirp(Manoeuvre):
    """Swing the wheel speed by ± `height`, at a steering angle: drive dynamics, combined slip."""

    middle: float
    height: float
    falling: bool

    def commands(self, t: float, car: Measured) -> tuple[float, float]:
        """Add a sine of sweeping frequency."""
        return self.turn * self.middle, max(0.1, self.speed + self.height * chirp(t, self.seconds, self.falling))


@dataclass(frozen=True, kw_only=True)
class BrakeInTurn(Manoeuvre):
    """Brake by the slip ratio `slip` in a turn: combined slip, the rear at large angles."""

    angle: float
    slip: float

    def commands(self, t: float, car: Measured) -> tuple[float, float]:
        """Turn for half of the time, then brake."""
        braking = t > 0.5 * self.seconds
        return self.turn * self.angle, max(0.0, car.v_x * (1.0 - self.slip)) if braking else self.speed


@dataclass(frozen=True, kw_only=True)
class PowerInTurn(Manoeuvre):
    """Let the wheels run `ahead` m/s faster in a turn, twice: power slides."""

    angle: float
    ahead: float

    def commands(self, t: float, car: Measured) -> tuple[float, float]:
        """Power in the second and in the last quarter."""
        power = int(4.0 * t / self.seconds) % 2 == 1
        return self.turn * self.angle, max(car.v_x, self.speed) + self.ahead if power else self.speed


@dataclass(frozen=True, kw_only=True)
class Flick(Manoeuvre):
    """Steer away, then in, with the brakes on: the tail swings round to large rear slip angles."""

    angle: float
    slip: float

    def commands(self, t: float, car: Measured) -> tuple[float, float]:
        """Away for 0.25 s, then in; brake for 0.3 s as the car swings."""
        side = -self.turn if t < 0.25 else self.turn
        braking = 0.35 < t < 0.65
        return side * self.angle, max(0.0, car.v_x * (1.0 - self.slip)) if braking else self.speed


@dataclass(frozen=True, kw_only=True)
class Circle(Manoeuvre):
    """Run round at one steering angle while the speed climbs to `top`: the balance of the axles, the limit of grip."""

    angle: float
    top: float

    @property
    def pace(self) -> float:
        """Take the mean of the speeds."""
        return 0.5 * (self.speed + self.top)

    def commands(self, t: float, car: Measured) -> tuple[float, float]:
        """Climb for four fifths of the time."""
        share = min(1.0, 1.25 * t / self.seconds)
        return self.turn * self.angle, self.speed + (self.top - self.speed) * share


@dataclass(frozen=True, kw_only=True)
class SmallReversals(Manoeuvre):
    """Small steering steps to both sides of zero, growing: play, dead bands, trim."""

    angle: float

    def commands(self, t: float, car: Measured) -> tuple[float, float]:
        """Change sides every 0.3 s."""
        size = self.angle * (0.2 + 0.8 * t / self.seconds)
        return (size if int(t / 0.3) % 2 == 0 else -size), self.speed


@dataclass(frozen=True, kw_only=True)
class Rest(Manoeuvre):
    """Stand still, and let the steering move a little: what cools, cools."""

    angle: float

    def commands(self, t: float, car: Measured) -> tuple[float, float]:
        """Three small steps to either side."""
        return self.angle * math.copysign(min(1.0, 0.34 + int(t / 0.8) * 0.33), math.sin(2.5 * math.pi * t)), 0.0


def chirp(t: float, seconds: float, falling: bool) -> float:
    """Return a sine whose frequency sweeps exponentially over `CHIRP` in `seconds`, or back."""
    t = seconds - t if falling else t
    low, high = CHIRP
    growth = math.log(high / low) / seconds
    return math.sin(2.0 * math.pi * low * math.expm1(growth * t) / growth)


def fast(limits: Limits, seconds: float) -> float:
    """Return the speed in m/s at which the floor's length allows a run-up, `seconds` of driving and braking."""
    length = 2.0 * (max(limits.half_x, limits.half_y) - limits.keep)
    squared = 1.0 / limits.braking + 1.0 / (2.0 * TRUSTED * limits.braking)
    linear = seconds + REACTION + 0.15
    return min((math.sqrt(linear**2 + 4.0 * squared * length) - linear) / (2.0 * squared), 0.95 * limits.speed_max)


def reference_block(limits: Limits) -> list[Manoeuvre]:
    """Return the manoeuvres that a programme begins and ends with, always the same."""
    quick, lock = fast(limits, 1.0), limits.steering_max
    return [
        CoastDown(speed=0.8 * quick, seconds=1.5, rate=0.3 * limits.braking),
        *(StepSteer(speed=0.6 * quick, seconds=1.0, turn=side, radius=1.5, angle=0.5 * lock) for side in (1, -1)),
        *(_circle(limits, side, 0.5, 1.0, 3.0) for side in (1, -1)),
        LaunchAndBrake(speed=0.3, seconds=1.6, top=quick, hold=0.8),
    ]


def catalogue(limits: Limits, generator: np.random.Generator) -> list[Manoeuvre]:
    """Return one round of all manoeuvres, in shuffled order, with sizes a little different every time."""

    def near(value: float) -> float:
        return value * generator.uniform(0.9, 1.1)

    manoeuvres = list(_round(limits, near))
    return [manoeuvres[i] for i in generator.permutation(len(manoeuvres))]


def _round(limits: Limits, near: Near) -> Iterator[Manoeuvre]:
    lock = limits.steering_max
    for share, rate in ((1.0, 0.5), (0.8, 0.25), (0.5, 0.12)):
        speed = near(share * fast(limits, 1.0))
        yield CoastDown(speed=speed, seconds=3.0, rate=near(rate * limits.braking))
    for share, steps in ((0.7, 3), (0.9, 2), (0.5, 4)):
        yield AccelerationStaircase(speed=0.4, seconds=3.5, top=near(share * fast(limits, 1.0)), steps=steps)
    for share, hold in ((0.6, 0.5), (1.0, 0.8), (1.3, 0.9)):
        top = min(near(share * fast(limits, 0.5)), limits.speed_max)
        yield LaunchAndBrake(speed=0.3, seconds=2.0, top=top, hold=hold)
    for share, slip in ((0.5, 0.12), (0.5, 0.3), (0.6, 0.6)):
        yield SlipRamp(speed=near(share * fast(limits, 1.0)), seconds=1.6, slip=near(slip))
    for side in (1, -1):
        yield from _turns(limits, side, near)
    for speed, angle in ((0.25, 0.06), (1.0, 0.04), (0.5 * fast(limits, 2.0), 0.03)):
        yield SmallReversals(speed=near(speed), seconds=3.0, angle=near(angle))
    yield Rest(speed=0.0, seconds=2.4, angle=near(0.5 * lock))


def _turns(limits: Limits, side: int, near: Near) -> Iterator[Manoeuvre]:
    lock, quick = limits.steering_max, fast(limits, 0.8)
    for share in (0.25, 0.45, 0.65, 0.8, 0.95):
        for size in (0.2, 0.5, 1.0) if share != 0.95 else (0.3, 0.8):
            speed = near(share * quick)
            radius = max(limits.radius(speed), limits.wheelbase / math.tan(size * lock))
            angle = min(near(size * lock), lock)
            yield StepSteer(speed=speed, seconds=1.2, turn=side, radius=radius, angle=angle)
    for share, seconds in ((0.25, 3.0), (0.45, 2.0), (0.65, 1.6)):
        speed = near(share * quick)
        yield RampToLock(speed=speed, seconds=seconds, turn=side, radius=limits.radius(speed), angle=lock)
    for share, size, falling in ((0.3, 0.6, False), (0.45, 0.35, side > 0), (0.6, 0.2, True)):
        speed = near(share * quick)
        middle = 0.35 * lock
        radius = max(limits.radius(speed), limits.wheelbase / math.tan(middle))
        yield SteeringChirp(
            speed=speed, seconds=4.5, turn=side, radius=radius, middle=middle, angle=near(size * lock), falling=falling
        )
    speed = near(0.45 * quick)
    yield SteeringChirp(speed=speed, seconds=3.5, middle=0.0, angle=side * near(0.25 * lock), falling=side > 0)
    yield SpeedChirp(speed=speed, seconds=3.0, middle=0.0, height=near(0.5 * speed), falling=side < 0)
    for size, share in ((0.5, 0.75), (0.8, 0.6)):
        speed = near(share * _cornering(limits, size))
        yield SpeedChirp(
            speed=speed,
            seconds=3.5,
            turn=side,
            radius=_radius(limits, size),
            middle=size * lock,
            height=near(0.4 * speed),
            falling=size > 0.6,
        )
    for size, share, slip in ((0.4, 0.9, 0.1), (0.5, 1.0, 0.25), (0.8, 1.2, 0.5), (0.5, 1.3, 1.0), (1.0, 1.3, 0.2)):
        speed = min(near(share * _cornering(limits, size)), quick)
        yield BrakeInTurn(
            speed=speed, seconds=1.4, turn=side, radius=limits.radius(speed), angle=size * lock, slip=near(slip)
        )
    for size, share, ahead in ((0.5, 0.7, 0.5), (0.7, 0.7, 1.2), (1.0, 0.8, 2.0), (0.6, 0.8, 3.0)):
        speed = near(share * _cornering(limits, size))
        yield PowerInTurn(
            speed=speed, seconds=2.0, turn=side, radius=_radius(limits, size), angle=size * lock, ahead=near(ahead)
        )
    for share, slip in ((0.6, 0.2), (0.75, 0.4), (0.9, 0.6)):
        yield Flick(speed=near(share * quick), seconds=1.3, turn=side, radius=1.5, angle=lock, slip=near(slip))
    for size, share in ((0.3, 1.1), (0.5, 1.2), (1.0, 1.3)):
        yield _circle(limits, side, size, share, near(5.0))


def _radius(limits: Limits, size: float) -> float:
    """Return the radius in m of a slow turn at a share of the steering."""
    return limits.wheelbase / math.tan(size * limits.steering_max)


def _cornering(limits: Limits, size: float) -> float:
    """Return the speed in m/s at which grip ends at a share of the steering."""
    return math.sqrt(limits.grip * _radius(limits, size))


def _circle(limits: Limits, side: int, size: float, share: float, seconds: float) -> Circle:
    speed = _cornering(limits, size)
    return Circle(
        speed=0.5 * speed,
        seconds=seconds,
        turn=side,
        radius=1.3 * _radius(limits, size),
        angle=size * limits.steering_max,
        top=share * speed,
    )
