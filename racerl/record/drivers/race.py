"""Laps round the track, near the limit of grip: a path follower that knows the configured car.

Steering is that of an arc to a point ahead, plus the understeer of the turn; the wheel speed is the line's, a little
ahead in time.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

from racerl.record.ability import Cornering, braking
from racerl.record.drivers import Command, Drive, Measured, Pose, Scene, check_ranges
from racerl.record.line import Line, find_line

LOST = 0.5  # m beside the line, or
TURNED = 0.9  # rad off its direction: the car is brought back slowly
SLOW = 0.6  # m/s


@dataclass(frozen=True)
class Race:
    """Settings of the laps."""

    share: float = 0.8  # of the grip that is used
    margin: float = 0.12  # m between the line and the track's edges
    preview: float = 0.25  # m, and
    preview_time: float = 0.1  # s, how far ahead the car steers for
    steering_max: float = 0.5  # rad
    speed_max: float = 7.0  # m/s
    block: float = 30.0  # s after which a new run begins

    def __post_init__(self) -> None:
        check_ranges(self, share=(0.05, 1.2), margin=(0.0, 10.0), preview=(0.05, 10.0), preview_time=(0.0, 2.0))
        check_ranges(self, steering_max=(0.05, 1.2), speed_max=(0.7, 60.0), block=(5.0, 600.0))

    def begin(self, scene: Scene) -> tuple[Pose, Callable[[Measured], Drive]]:
        """Start on the line's first point."""
        line, cornering = self.line(scene)
        return Pose(line.x[0], line.y[0], line.yaw[0]), lambda measured: self.laps(scene, line, cornering, measured)

    def laps(self, scene: Scene, line: Line, cornering: Cornering, car: Measured) -> Drive:
        """Lap without end."""
        index, run, run_start = 0, 0, car.t
        while True:
            index = line.nearest(car, index)
            if car.t - run_start > self.block:
                run, run_start = run + 1, car.t
            car = yield Command(*self.pursue(line, cornering, index, car), run, "race")

    def line(self, scene: Scene) -> tuple[Line, Cornering]:
        """Return the line to be driven, and what the car can do."""
        cornering = Cornering.of(scene.vehicle)
        line = find_line(
            scene.track,
            cornering,
            braking(scene.vehicle),
            share=self.share,
            margin=self.margin,
            steering=self.steering_max,
            fastest=self.speed_max,
        )
        return line, cornering

    def pursue(self, line: Line, cornering: Cornering, index: int, car: Measured) -> tuple[float, float]:
        """Return (delta_ref, omega_ref) for a car near the line's point `index`."""
        speed = max(car.v_x, 0.0)
        ahead = line.at(index, self.preview + self.preview_time * speed)
        dx, dy = line.x[ahead] - car.x, line.y[ahead] - car.y
        sin, cos = math.sin(car.yaw), math.cos(car.yaw)
        forward, left = cos * dx + sin * dy, cos * dy - sin * dx
        bend = 2.0 * left / (dx * dx + dy * dy) if forward > 0.0 else math.copysign(10.0, left)
        soon = line.at(index, 0.1 * speed)
        acceleration = speed**2 * line.curvature[soon]
        delta = math.atan(cornering.wheelbase * bend) + float(cornering.understeer(acceleration))
        omega = min(line.speed[soon], 1.1 * speed + 0.5)
        beside = math.hypot(line.x[index] - car.x, line.y[index] - car.y)
        if beside > LOST or abs(math.remainder(car.yaw - line.yaw[index], 2.0 * math.pi)) > TURNED:
            omega = min(omega, SLOW)
        return min(max(delta, -self.steering_max), self.steering_max), omega
