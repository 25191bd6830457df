"""Open-loop manoeuvres of 15 s: δ_ref in rad and ω_ref in m/s as functions of the time t in s, (n,).

Amplitudes are those of a car with 0.33 m wheelbase that corners with about 4 m/s². Starts are spread over a place of
12 m × 12 m so that the paths cross its middle from all sides, early and late; a slight bend brings the cars back.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tests.gap.plant.tyre import Array

Commands = Callable[[Array, np.random.Generator], tuple[Array, Array]]
DURATION = 15.0  # s


@dataclass(frozen=True)
class Manoeuvre:
    """What is commanded, and the pose x, y, yaw from which, in m and rad."""

    commands: Commands
    start: tuple[float, float, float]


def stairs(t: Array, every: float, *levels: float) -> Array:
    """Hold each level for `every` s, and the last from then on."""
    return np.array(levels)[np.clip((t / every).astype(int), 0, len(levels) - 1)]


def line(t: Array, *corners: tuple[float, float]) -> Array:
    """Straight pieces through (time, value); a time given twice is a step."""
    times, values = np.array(corners).T
    return np.interp(t, times + 1e-6 * np.arange(len(times)), values)


def wander(t: Array, rng: np.random.Generator, size: float, periods: tuple[float, float]) -> Array:
    """A smooth random function of time of standard deviation `size`, five sines with periods in s."""
    period = rng.uniform(*periods, size=5)
    phase = rng.uniform(0, 2 * np.pi, size=5)
    return size * np.sqrt(2 / 5) * np.sin(2 * np.pi * t[:, None] / period + phase).sum(axis=1)


def step_steers(t: Array, size: float) -> Array:
    """Steps to either side of a quarter, a half and the whole of `size`, with straights between."""
    q, h, f = 0.25 * size, 0.55 * size, size
    return stairs(t, 1.1, 0, q, 0, -q, 0, h, 0, -h, 0, f, 0, -f, 0, q)


def step_steers_slow(t: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Three sizes at 2 m/s."""
    return 0.05 + step_steers(t, 0.30), 2.0 + 0 * t


def step_steers_fast(t: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Three sizes at 3.5 m/s."""
    return -0.04 + step_steers(t, 0.25), 3.5 + 0 * t


def chirp_up(t: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """0.3 to 5 Hz, small, at 2.8 m/s."""
    return 0.06 + 0.12 * np.sin(2 * np.pi * (0.3 * t + 0.5 * 4.7 * t**2 / DURATION)), 2.8 + 0 * t


def chirp_down(t: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """5 to 0.3 Hz, large, at 2 m/s."""
    return -0.08 + 0.24 * np.sin(2 * np.pi * (5.0 * t - 0.5 * 4.7 * t**2 / DURATION)), 2.0 + 0 * t


def lock_ramps_slow(t: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """From lock to lock at 1.4 m/s."""
    return line(t, (0, 0), (4, 0.36), (9.5, -0.36), (13, 0), (15, 0.2)), 1.4 + 0 * t


def lock_ramps_fast(t: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """From lock to lock at 3 m/s."""
    delta = line(t, (0, 0), (2, 0.36), (3, 0), (5, -0.36), (6, 0), (8, 0.36), (12, -0.36), (15, 0))
    return delta, 3.0 + 0 * t


def throttle_and_brake(t: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Speed steps on straights joined by slow turns."""
    delta = line(t, (0, 0), (3, 0), (3, 0.33), (5, 0.33), (5, 0), (8, 0), (8, -0.33), (10, -0.33), (10, 0), (15, 0))
    omega = stairs(t, 0.5, 1.5, 1.5, 3, 3, 3, 1.5, *[1.5] * 4, 3, 4.5, 4.5, 2.5, 3.5, 1.5, *[1.5] * 4,
                   3.5, 3.5, 5, 5, 5, 3, 4, 4, 1, 2, 1, 2)  # fmt: skip
    return delta, omega


def coast_downs(t: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """To a stop slowly from 4.5 m/s, at once from 3.5 m/s, and slowly from 2.5 m/s."""
    omega = line(t, (0, 4.5), (1.2, 4.5), (5, 0), (5.5, 0), (5.5, 1.5), (8, 1.5), (8, 3.5), (10, 3.5), (10, 0),
                 (11.5, 0), (11.5, 2.5), (13, 2.5), (15, 0))  # fmt: skip
    return line(t, (0, 0), (5.7, 0), (5.7, 0.35), (8, 0.35), (8, 0), (15, 0)), omega


def circle_left(t: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """One steering angle, five speeds."""
    return 0.2 + 0 * t, stairs(t, 3.0, 1.0, 1.6, 2.2, 2.8, 3.4)


def circle_right(t: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """One steering angle, five speeds."""
    return -0.2 + 0 * t, stairs(t, 3.0, 1.0, 1.6, 2.2, 2.8, 3.4)


def tight_circles(t: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """The smaller radius at four speeds, left and then right."""
    return stairs(t, 7.5, 0.33, -0.33), stairs(t, 1.9, 1.0, 1.5, 2.0, 2.6, 1.0, 1.5, 2.0, 2.6)


def equal_yaw_rates(t: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """About 1.1 rad/s at 1.3 and at 3 m/s, to either side."""
    omega = line(t, (0, 1.3), (3.5, 1.3), (4.2, 3), (7.5, 3), (7.5, 1.3), (11, 1.3), (11.7, 3), (15, 3))
    return stairs(t, 3.75, 0.32, 0.2, -0.32, -0.2), omega


def figure_eights(t: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Two eights, the second one faster."""
    return 0.3 * np.tanh(3 * np.sin(2 * np.pi * t / 7.5)), stairs(t, 7.5, 1.8, 2.4)


def slalom(t: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """0.75 Hz at four speeds."""
    return 0.05 + 0.17 * np.sin(2 * np.pi * 0.75 * t), stairs(t, 3.75, 2.2, 3.0, 3.8, 1.5)


def power_in_turns(t: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Power on and off in a turn to the left, then to the right."""
    return stairs(t, 7.5, 0.24, -0.24), stairs(t, 1.5, 1.8, 2.7, 1.8, 3.1, 1.4, 1.8, 2.7, 1.8, 3.1, 1.4)


def straights(t: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """There and back at 3 m/s, with slow turns at the ends."""
    turning = np.mod(t, 4.6) > 2.2
    return np.where(turning, 0.36, 0.0), np.where(turning, 1.6, 3.0)


def hard_and_soft(t: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Hard slalom, a stop, gentle driving, hard slalom again."""
    hard = (t < 5.0) | (t > 11.0)
    delta = -0.06 + np.where(hard, 0.28, 0.06) * np.sin(2 * np.pi * 0.6 * t)
    return delta, line(t, (0, 3.3), (5, 3.3), (5.6, 0), (8.5, 0), (8.5, 1.4), (11, 1.4), (11.5, 3.3), (15, 3.3))


def random_gentle(t: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Multisine steering, random speed steps from 1 to 3 m/s."""
    return 0.08 + wander(t, rng, 0.10, (0.4, 3.0)), stairs(t, 1.2, *rng.uniform(1.0, 3.0, size=13))


def random_hard(t: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Multisine steering, random speed steps from 1.5 to 4.5 m/s."""
    return -0.06 + wander(t, rng, 0.12, (0.5, 4.0)), stairs(t, 1.5, *rng.uniform(1.5, 4.5, size=10))


def pottering(t: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """0.5 to 0.9 m/s, steering within 0.03 rad."""
    return wander(t, rng, 0.01, (4.0, 9.0)), 0.7 + wander(t, rng, 0.07, (6.0, 12.0))


def ramping(angle: float) -> Commands:
    """A throttle ramp of 0.22 m/s² from 1 to 4.5 m/s on the circle that this angle in rad makes."""
    return lambda t, rng: (angle + 0 * t, np.minimum(1.0 + 0.22 * t, 4.5))


def standing(t: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """No command."""
    return 0 * t, 0 * t


def strolling(t: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """A bend to either side at about 2 m/s."""
    return 0.12 * np.sin(2 * np.pi * t / 5.0), 2.0 + wander(t, rng, 0.2, (3.0, 6.0))


EXCITATION = (
    Manoeuvre(step_steers_slow, (-3.0, -1.0, 0.3)),
    Manoeuvre(circle_left, (0.0, -0.5, 0.0)),
    Manoeuvre(straights, (-3.3, -0.8, 0.0)),
    Manoeuvre(random_hard, (2.0, 2.0, -2.4)),
    Manoeuvre(throttle_and_brake, (-4.0, 0.0, 0.0)),
    Manoeuvre(chirp_up, (4.0, 4.0, -2.4)),
    Manoeuvre(equal_yaw_rates, (0.0, 1.0, 3.1)),
    Manoeuvre(lock_ramps_slow, (1.0, -1.0, 1.6)),
    Manoeuvre(hard_and_soft, (3.0, 0.0, 3.1)),
    Manoeuvre(coast_downs, (0.0, -5.0, 1.6)),
    Manoeuvre(circle_right, (0.0, 0.5, 0.0)),
    Manoeuvre(slalom, (4.0, -4.0, 2.4)),
    Manoeuvre(power_in_turns, (0.0, -1.5, 0.0)),
    Manoeuvre(lock_ramps_fast, (-2.0, 2.0, -0.8)),
    Manoeuvre(chirp_down, (0.0, 4.0, -1.6)),
    Manoeuvre(tight_circles, (0.0, -0.6, 0.0)),
    Manoeuvre(step_steers_fast, (-4.0, 3.0, -0.6)),
    Manoeuvre(figure_eights, (0.0, 0.0, 0.8)),
    Manoeuvre(random_gentle, (2.0, -2.0, 2.4)),
    Manoeuvre(straights, (3.3, 0.8, 3.14)),
)
"""The programme, in this order; the last repeats straights of the beginning the other way."""
