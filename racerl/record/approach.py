"""Ways to a start: arc, straight, arc (L. E. Dubins, 1957), then a run-up, and the steering that follows them.

If a turning circle beside the car and one beside the goal lie on the floor, so does the way between them: it stays in
their convex hull, and the floor is convex.
"""

import math
from dataclasses import dataclass

from racerl.record.drivers import Measured, Pose
from racerl.record.floor import Limits

SPACING = 0.05  # m between points of a way
BEYOND = 8  # points past the end, to look ahead to
SLOWEST = 0.25  # m/s, so that every end is reached
Point = tuple[float, float, bool]  # x and y in m, and whether it lies in a turn


@dataclass(frozen=True)
class Way:
    """Points to be passed, evenly spaced, with the speed allowed at each."""

    x: list[float]  # m
    y: list[float]  # m
    speed: list[float]  # m/s
    clear: bool  # keeps off the margin

    @property
    def end(self) -> int:
        """Index at which the way is done."""
        return len(self.x) - BEYOND

    def nearest(self, car: Measured, since: int) -> int:
        """Return the index of the nearest point, looked for from `since` on for a metre."""
        until = min(len(self.x), since + round(1.0 / SPACING))
        return min(range(since, until), key=lambda i: (self.x[i] - car.x) ** 2 + (self.y[i] - car.y) ** 2)

    def distance(self, car: Measured, index: int) -> float:
        """Return the car's distance from a point in m."""
        return math.hypot(self.x[index] - car.x, self.y[index] - car.y)


def find_way(
    car: Pose, goal: Pose, run_up: float, speed: float, slow: float, limits: Limits, tighter: bool = False
) -> Way:
    """Return a way from the car to the goal and `run_up` metres on.

    Its turns are driven at `slow`, its end is passed at `speed` (m/s).
    The shortest way that keeps off the margin is taken, of tighter turns if those are allowed and needed; when none
    does, the one that stays farthest inside.
    """
    for radius in (limits.way_radius, limits.turning_radius, 0.85 * limits.turning_radius):
        ways = [
            points
            for first in (1, -1)
            for last in (1, -1)
            if (points := _points(car, goal, radius, first, last)) is not None
        ]
        clear = [points for points in ways if _clearance(points, limits) >= limits.margin]
        if clear or not tighter:
            break
    points = min(clear, key=len) if clear else max(ways, key=lambda points: _clearance(points, limits))
    slow = min(slow, slow_speed(limits, 0.25)) if radius < limits.way_radius else slow
    gain = 0.5 * limits.braking
    allowed = [slow if bent else 2.2 * slow for _, _, bent in points]
    for i in range(len(allowed) - 2, -1, -1):
        allowed[i] = min(allowed[i], math.sqrt(allowed[i + 1] ** 2 + 2.0 * gain * SPACING))
    allowed[0] = slow
    for i in range(1, len(allowed)):
        allowed[i] = min(allowed[i], math.sqrt(allowed[i - 1] ** 2 + 2.0 * gain * SPACING))
    count = math.ceil(run_up / SPACING) + BEYOND
    cos, sin = math.cos(goal.yaw), math.sin(goal.yaw)
    points = points + [(goal.x + i * SPACING * cos, goal.y + i * SPACING * sin, False) for i in range(1, count)]
    final = max(speed, SLOWEST)
    allowed += [min(final, math.sqrt(allowed[-1] ** 2 + 2.0 * gain * i * SPACING)) for i in range(1, count)]
    return Way([x for x, _, _ in points], [y for _, y, _ in points], allowed, bool(clear))


def turned(car: Pose, side: int, angle: float, limits: Limits) -> Pose:
    """Return where the car is after turning by `angle` rad to a side (1 left)."""
    radius, yaw = side * limits.way_radius, car.yaw + side * angle
    x, y = car.x - radius * math.sin(car.yaw), car.y + radius * math.cos(car.yaw)
    return Pose(x + radius * math.sin(yaw), y - radius * math.cos(yaw), yaw)


def slow_speed(limits: Limits, share: float = 0.45) -> float:
    """Return the speed in m/s at which a way's turns use a share of the grip."""
    return math.sqrt(share * limits.grip * limits.way_radius)


def run_up_length(speed: float, slow: float, limits: Limits) -> float:
    """Return the metres needed to reach a speed from the slow one, and to settle."""
    return max(0.0, speed**2 - slow**2) / limits.braking + 0.15 * speed + 0.2


def follow(way: Way, index: int, car: Measured, limits: Limits) -> tuple[float, float]:
    """Return (delta_ref, omega_ref) of a pure pursuit along the way."""
    speed = max(car.v_x, 0.0)
    ahead = min(len(way.x) - 1, index + round((0.3 + 0.12 * speed) / SPACING))
    dx, dy = way.x[ahead] - car.x, way.y[ahead] - car.y
    sin, cos = math.sin(car.yaw), math.cos(car.yaw)
    forward, left = cos * dx + sin * dy, cos * dy - sin * dx
    bend = 2.0 * left / max(dx * dx + dy * dy, 0.04)
    if forward < 0.0:  # behind: turn as tightly as possible
        bend = math.copysign(1e3, left)
    delta = math.atan(limits.wheelbase * bend)
    lead = min(len(way.speed) - 1, index + round(0.1 * speed / SPACING))
    return clip(delta, limits.steering_max), min(way.speed[index], way.speed[lead])


def clip(value: float, limit: float) -> float:
    """Return the value inside ± limit."""
    return min(max(value, -limit), limit)


def _clearance(points: list[Point], limits: Limits) -> float:
    """Return the smallest distance from the edge in m."""
    return min(min(limits.half_x - abs(x), limits.half_y - abs(y)) for x, y, _ in points)


def _points(car: Pose, goal: Pose, radius: float, first: int, last: int) -> list[Point] | None:
    """Return (x, y, in a turn?) of the way that turns to sides `first` and `last` (1 left), or None."""
    c_x, c_y = car.x - first * radius * math.sin(car.yaw), car.y + first * radius * math.cos(car.yaw)
    g_x, g_y = goal.x - last * radius * math.sin(goal.yaw), goal.y + last * radius * math.cos(goal.yaw)
    across = radius * (first - last)
    squared = (g_x - c_x) ** 2 + (g_y - c_y) ** 2 - across**2
    if squared < 0.0:
        return None
    straight = math.sqrt(squared)
    course = math.atan2(g_y - c_y, g_x - c_x) + math.atan2(across, straight)
    arrive = Pose(c_x + radius * first * math.sin(course), c_y - radius * first * math.cos(course), course)
    steps = math.floor(straight / SPACING)
    line = [
        (arrive.x + i * SPACING * math.cos(course), arrive.y + i * SPACING * math.sin(course), False)
        for i in range(1, steps)
    ]
    leave = Pose(arrive.x + straight * math.cos(course), arrive.y + straight * math.sin(course), course)
    return [
        *_arc(car, radius * first, _sweep(first * (course - car.yaw))),
        *line,
        *_arc(leave, radius * last, _sweep(last * (goal.yaw - course))),
    ]


def _arc(start: Pose, radius: float, sweep: float) -> list[Point]:
    """Return the points of a turn by `sweep` rad; a positive radius turns left."""
    count = max(1, round(sweep * abs(radius) / SPACING))
    x, y = start.x - radius * math.sin(start.yaw), start.y + radius * math.cos(start.yaw)
    angles = [start.yaw + math.copysign(sweep, radius) * i / count for i in range(count + 1)]
    return [(x + radius * math.sin(angle), y - radius * math.cos(angle), sweep > 0.1) for angle in angles]


def _sweep(angle: float) -> float:
    """Return an angle in [0, 2π), with almost a full turn counted as none."""
    angle %= 2.0 * math.pi
    return 0.0 if angle > 2.0 * math.pi - 1e-3 else angle
