"""A stand-in for a person at the wheel: the race driver with a late, short-sighted and unsteady hand.

It acts on what it saw a reaction time ago, carried on at constant velocities, and wavers: two first-order Gauss–Markov
processes are added to its commands. It is a label for logs of that kind, and no model of any person.
"""

import math
from collections import deque
from dataclasses import dataclass

from racerl.record.ability import Cornering
from racerl.record.drivers import Command, Drive, Measured, Scene, check_ranges
from racerl.record.drivers.race import Race
from racerl.record.line import Line


@dataclass(frozen=True)
class HumanLike(Race):
    """The race driver's settings, tamer, and those of the hand."""

    share: float = 0.4
    margin: float = 0.3  # m
    preview: float = 0.35  # m
    preview_time: float = 0.15  # s
    reaction: float = 0.15  # s
    steering_noise: float = 0.02  # rad, standard deviation
    speed_noise: float = 0.15  # m/s, standard deviation
    noise_time: float = 0.4  # s over which the noise is correlated
    smoothing: float = 0.08  # s, time constant of the hand

    def __post_init__(self) -> None:
        super().__post_init__()
        check_ranges(
            self, reaction=(0.0, 1.0), steering_noise=(0.0, 0.5), speed_noise=(0.0, 3.0), noise_time=(0.01, 10.0)
        )
        check_ranges(self, smoothing=(0.0, 1.0))

    def laps(self, scene: Scene, line: Line, cornering: Cornering, car: Measured) -> Drive:
        """Lap without end."""
        seen = deque([car], maxlen=1 + round(self.reaction / scene.dt))
        index, run, run_start = 0, 0, car.t
        keep, follow = math.exp(-scene.dt / self.noise_time), 1.0 - math.exp(-scene.dt / max(self.smoothing, 1e-6))
        fresh = math.sqrt(1.0 - keep**2)
        waver_delta = waver_omega = delta = omega = 0.0
        while True:
            imagined = carry_on(seen[0], car.t - seen[0].t)
            index = line.nearest(imagined, index)
            if car.t - run_start > self.block:
                run, run_start = run + 1, car.t
            wanted_delta, wanted_omega = self.pursue(line, cornering, index, imagined)
            dice_delta, dice_omega = scene.generator.standard_normal(2).tolist()
            waver_delta = keep * waver_delta + fresh * self.steering_noise * dice_delta
            waver_omega = keep * waver_omega + fresh * self.speed_noise * dice_omega
            delta += follow * (wanted_delta + waver_delta - delta)
            omega += follow * (wanted_omega + waver_omega - omega)
            delta = min(max(delta, -self.steering_max), self.steering_max)
            car = yield Command(delta, min(max(omega, 0.0), self.speed_max), run, "human_like")
            seen.append(car)


def carry_on(car: Measured, seconds: float) -> Measured:
    """Return where the car would be after some time at constant velocities."""
    yaw = car.yaw + 0.5 * seconds * car.yaw_rate
    sin, cos = math.sin(yaw), math.cos(yaw)
    return car._replace(
        x=car.x + seconds * (cos * car.v_x - sin * car.v_y),
        y=car.y + seconds * (sin * car.v_x + cos * car.v_y),
        yaw=car.yaw + seconds * car.yaw_rate,
    )
