"""The floor: where the car may be, what it may do there, and when it must brake to stay.

A manoeuvre may go on as long as the car, braking now, would stop at a place from where it can turn around in any
direction: `keep` metres from every edge. The braking that is counted on is a share of what the configured vehicle has.
"""

import math
from dataclasses import dataclass

from racerl.errors import ConfigError
from racerl.record.ability import Cornering, braking
from racerl.record.drivers import Measured, Scene

TRUSTED = 0.65  # share of the vehicle's braking that is counted on: the driven car may be more slippery
REACTION = 0.15  # s until a command has become a force
SLACK = 1.3  # turning circle that is counted on, as a share of the smallest


@dataclass(frozen=True)
class Limits:
    """What the driver trusts the car to do on this floor."""

    half_x: float  # m
    half_y: float  # m
    margin: float  # m, never to be entered
    steering_max: float  # rad
    speed_max: float  # m/s
    wheelbase: float  # m
    grip: float  # m/s², lateral
    braking: float  # m/s², of the configured vehicle

    @classmethod
    def of(cls, scene: Scene, margin: float, steering_max: float, speed_max: float) -> "Limits":
        """Reckon the limits of the configured vehicle; raise ConfigError when the floor is too small for it."""
        vehicle = scene.vehicle
        limits = cls(
            half_x=scene.floor[0] / 2,
            half_y=scene.floor[1] / 2,
            margin=margin,
            steering_max=steering_max,
            speed_max=speed_max,
            wheelbase=float(vehicle.wheelbase),
            grip=Cornering.of(vehicle).grip,
            braking=braking(vehicle),
        )
        needed = 2.0 * (limits.margin + 2.2 * limits.turning_radius)
        if min(scene.floor) < needed:
            raise ConfigError(
                f"floor = {list(scene.floor)}: this car needs {needed:.1f} m × {needed:.1f} m at least to turn around"
            )
        return limits

    @property
    def turning_radius(self) -> float:
        """Radius of the turns that the car is trusted to drive slowly, in m."""
        return SLACK * self.wheelbase / math.tan(self.steering_max)

    @property
    def way_radius(self) -> float:
        """Radius of the turns of a way in m, wider than the tightest to leave room for corrections."""
        return 1.15 * self.turning_radius

    @property
    def keep(self) -> float:
        """Distance from the edge at which the car can still turn around from any heading, in m."""
        return self.way_radius + self.margin

    def radius(self, speed: float) -> float:
        """Return the radius of a turn at the limit of grip, in m."""
        return max(speed**2 / self.grip, self.turning_radius)

    def stopping(self, speed: float) -> float:
        """Return the distance in m in which the car surely stops."""
        return speed**2 / (2.0 * TRUSTED * self.braking) + REACTION * speed

    def inside(self, x: float, y: float, inset: float) -> bool:
        """Tell whether a place is at least `inset` metres from every edge."""
        return abs(x) <= self.half_x - inset and abs(y) <= self.half_y - inset

    def safe(self, car: Measured, inset: float) -> bool:
        """Tell whether the car, braking now, stops at least `inset` metres from every edge."""
        speed = math.hypot(car.v_x, car.v_y)
        if speed < 1e-3:
            return True
        course = car.yaw + math.atan2(car.v_y, car.v_x)
        way = self.stopping(speed)
        return self.inside(car.x + way * math.cos(course), car.y + way * math.sin(course), inset)
