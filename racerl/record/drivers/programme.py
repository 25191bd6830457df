"""An excitation programme: manoeuvre after manoeuvre on a floor that is never left.

A reference block comes first and, repeated, last. In between all manoeuvres follow in shuffled order, round by round.
Before each the car drives to a place from where there is room; a manoeuvre is broken off when the car must brake now
to stay on the floor. A new run begins after every `block` seconds, between two manoeuvres. The car reverses only when
it is stuck at the edge, because it turns less tightly than the configured one.
"""

import logging
import math
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass

from racerl.record.approach import SPACING, clip, find_way, follow, run_up_length, slow_speed, turned
from racerl.record.drivers import Command, Drive, Measured, Pose, Scene, check_ranges
from racerl.record.floor import Limits
from racerl.record.manoeuvres import Manoeuvre, catalogue, reference_block

log = logging.getLogger(__name__)

Leg = Generator[Command, Measured, Measured]
CRAWL = 0.5  # m/s
PACES = (0.25, 0.65)  # shares of the grip used in the turns of a way
NEAREST = 0.1  # m from the edge, where the car is stopped rather than let on
ASTRAY = 0.45  # m beside its way at which the car looks for another
CHOICES = 30  # starts looked at anywhere
TURNS = (0.5, 1.0, 1.5, 2.0, 2.5, 3.0)  # rad, after which a start is looked at
WORTH = 12.0  # s of transit that a whole manoeuvre is worth
PIECES = 8  # of a manoeuvre, to see whether it fits
SPARE = 18.0  # s for the manoeuvre under way and a longer way to the last block
PATIENCE = 30.0  # s for one approach


@dataclass(frozen=True)
class Programme:
    """The excitation programme's settings."""

    margin: float = 0.3  # m from the edge of the floor, not to be entered
    steering_max: float = 0.5  # rad
    speed_max: float = 7.0  # m/s
    block: float = 30.0  # s after which a new run begins

    def __post_init__(self) -> None:
        check_ranges(self, margin=(0.0, 5.0), steering_max=(0.1, 1.2), speed_max=(1.0, 60.0), block=(5.0, 600.0))

    def begin(self, scene: Scene) -> tuple[Pose, Callable[[Measured], Drive]]:
        """Start in the middle of the floor, along its longer side."""
        limits = Limits.of(scene, self.margin, self.steering_max, self.speed_max)
        pose = Pose(0.0, 0.0, 0.0 if scene.floor[0] >= scene.floor[1] else math.pi / 2)
        return pose, _Pilot(self.block, scene, limits).drive


class _Pilot:
    """The programme under way; its methods are legs: coroutines that return the last measurement."""

    def __init__(self, block: float, scene: Scene, limits: Limits) -> None:
        self.block, self.scene, self.limits = block, scene, limits
        self.run, self.run_start = 0, 0.0

    def drive(self, car: Measured) -> Drive:
        """Drive the reference block, shuffled rounds, and the reference block again."""
        block = reference_block(self.limits)
        for manoeuvre in block:
            car = yield from self.perform(manoeuvre, True, car)
        needed = car.t + SPARE
        if self.scene.seconds < 2.0 * needed:
            log.warning(
                "%g s are too short: the first block took %.0f s and may not come again whole",
                self.scene.seconds,
                car.t,
            )
        self.next_run(car)
        for manoeuvre in self.rounds():
            if car.t > self.scene.seconds - needed:
                break
            if car.t - self.run_start > self.block:
                self.next_run(car)
            car = yield from self.perform(manoeuvre, False, car)
        self.next_run(car)
        for manoeuvre in block:
            car = yield from self.perform(manoeuvre, True, car)
        while True:
            car = yield self.command(0.0, 0.0, "rest")

    def next_run(self, car: Measured) -> None:
        self.run, self.run_start = self.run + 1, car.t

    def command(self, delta_ref: float, omega_ref: float, doing: str) -> Command:
        limits = self.limits
        return Command(
            clip(delta_ref, limits.steering_max), min(max(omega_ref, -CRAWL), limits.speed_max), self.run, doing
        )

    def rounds(self) -> Iterator[Manoeuvre]:
        while True:
            yield from catalogue(self.limits, self.scene.generator)

    def perform(self, manoeuvre: Manoeuvre, fixed: bool, car: Measured) -> Leg:
        """Approach, drive and leave one manoeuvre."""
        car = yield from self.approach(manoeuvre, fixed, car)
        start = car.t
        while (t := car.t - start) < manoeuvre.seconds:
            if not self.limits.safe(car, self.limits.keep):
                break
            car = yield self.command(*manoeuvre.commands(t, car), manoeuvre.kind)
        return (yield from self.calm(car))

    def calm(self, car: Measured) -> Leg:
        """Slow down, gently while there is room, until the car can turn."""
        slow = slow_speed(self.limits)
        target = car.v_x
        while math.hypot(car.v_x, car.v_y) > slow or abs(car.yaw_rate) > 2.5:
            into = math.atan2(car.v_y + 0.5 * self.limits.wheelbase * car.yaw_rate, max(car.v_x, 0.3))
            if self.limits.safe(car, self.limits.keep):
                target = max(min(target, car.v_x + 0.3) - 0.4 * self.limits.braking * self.scene.dt, 0.0)
            else:
                target = 0.0
            car = yield self.command(into, target if car.v_x > 0 else 0.0, "brake")
        return car

    def approach(self, manoeuvre: Manoeuvre, fixed: bool, car: Measured) -> Leg:
        """Drive to where the manoeuvre starts, at its speed."""
        limits, since = self.limits, car.t
        # every way at another pace: transits are most of the drive, and data too
        slow = slow_speed(limits) if fixed else slow_speed(limits, self.scene.generator.uniform(*PACES))
        run_up = run_up_length(manoeuvre.speed, slow, limits)
        here = Pose(car.x, car.y, car.yaw)
        starts = home_starts(manoeuvre, run_up, limits)
        goal = starts[0] if fixed else self.choose(here, manoeuvre, run_up, slow, starts)
        way, index = find_way(here, goal, run_up, manoeuvre.speed, slow, limits, tighter=True), 0
        while index < way.end and car.t - since < PATIENCE:
            index = way.nearest(car, index)
            stuck = not limits.safe(car, NEAREST) and math.hypot(car.v_x, car.v_y) < 1.5 * CRAWL
            if stuck:
                car = yield from self.back_up(car)
            if stuck or way.distance(car, index) > ASTRAY:
                car = yield from self.stop(car)
                here = Pose(car.x, car.y, car.yaw)
                way, index = find_way(here, goal, run_up, manoeuvre.speed, slow, limits, tighter=True), 0
            delta_ref, omega_ref = follow(way, index, car, limits)
            if not limits.safe(car, 0.5 * limits.margin):
                delta_ref, omega_ref = self.escape(car, delta_ref), min(omega_ref, CRAWL)
            car = yield self.command(delta_ref, omega_ref, "transit")
        return car

    def back_up(self, car: Measured) -> Leg:
        """Reverse on the other lock until there is room to turn: this car turns less tightly than was thought."""
        lock, since = -self.escape(car, 0.0), car.t
        while car.t - since < 6.0:
            behind = car.yaw + math.pi
            way = self.limits.stopping(CRAWL) + NEAREST
            room = self.limits.inside(car.x + way * math.cos(behind), car.y + way * math.sin(behind), NEAREST)
            if not room or self.limits.inside(car.x, car.y, self.limits.keep):
                break
            car = yield self.command(lock, -CRAWL, "reverse")
        while abs(car.v_x) > 0.1:
            car = yield self.command(0.0, 0.0, "brake")
        return car

    def escape(self, car: Measured, delta_ref: float) -> float:
        """Return full lock: to the side that is steered to, or else to the floor's middle."""
        lock = self.limits.steering_max
        left = math.sin(car.yaw) * car.x - math.cos(car.yaw) * car.y
        return math.copysign(lock, delta_ref if abs(delta_ref) > 0.3 * lock else left)

    def choose(self, here: Pose, manoeuvre: Manoeuvre, run_up: float, slow: float, starts: list[Pose]) -> Pose:
        """Return the start that is soonest reached, among here, at home and anywhere, with room for the most."""
        limits, generator = self.limits, self.scene.generator
        anywhere = [
            Pose(
                generator.uniform(-limits.half_x, limits.half_x),
                generator.uniform(-limits.half_y, limits.half_y),
                generator.uniform(-math.pi, math.pi),
            )
            for _ in range(CHOICES)
        ]

        near = [turned(here, side, angle, limits) for side in (1, -1) for angle in TURNS]

        def cost(start: Pose) -> float:
            share = room(start, manoeuvre, run_up, limits)
            way = find_way(here, start, run_up, manoeuvre.speed, slow, limits) if share > 0.3 else None
            return math.inf if way is None or not way.clear else len(way.x) * SPACING / slow - WORTH * share

        return min([*starts, here, *near, *(start for start in anywhere if can_turn(start, limits))], key=cost)

    def stop(self, car: Measured) -> Leg:
        """Brake to a crawl."""
        while math.hypot(car.v_x, car.v_y) > CRAWL:
            car = yield self.command(0.0, 0.0, "brake")
        return car


def can_turn(start: Pose, limits: Limits) -> bool:
    """Tell whether turning circles to both sides lie on the floor, so that a way leads here from anywhere."""
    radius = limits.way_radius
    across, along = radius * math.sin(start.yaw), radius * math.cos(start.yaw)
    inset = radius + limits.margin
    return limits.inside(start.x - across, start.y + along, inset) and limits.inside(
        start.x + across, start.y - along, inset
    )


def room(start: Pose, manoeuvre: Manoeuvre, run_up: float, limits: Limits) -> float:
    """Return the share of the manoeuvre that is expected to be driven before the guard breaks it off."""
    x, y, yaw = start.x + run_up * math.cos(start.yaw), start.y + run_up * math.sin(start.yaw), start.yaw
    way = limits.stopping(manoeuvre.pace)
    bend = manoeuvre.turn / max(manoeuvre.radius, 0.1)
    for i in range(PIECES):
        if not limits.inside(x + way * math.cos(yaw), y + way * math.sin(yaw), limits.keep):
            return i / PIECES
        step = manoeuvre.pace * manoeuvre.seconds / PIECES
        x, y, yaw = x + step * math.cos(yaw), y + step * math.sin(yaw), yaw + step * bend
    return 1.0


def home_starts(manoeuvre: Manoeuvre, run_up: float, limits: Limits) -> list[Pose]:
    """Return two run-ups along the floor, one each way: from its far end, or so that a turn has its middle there."""
    along, across = max(limits.half_x, limits.half_y), min(limits.half_x, limits.half_y)
    turn = limits.way_radius
    back = along - 2.0 * limits.margin - turn
    x = -back if manoeuvre.turn == 0 else max(-back, min(-0.3, along - limits.keep - manoeuvre.radius) - run_up)
    y = clip(-manoeuvre.turn * manoeuvre.radius, max(0.0, across - 1.2 * limits.margin - 2.0 * turn))
    if limits.half_x >= limits.half_y:
        return [Pose(x, y, 0.0), Pose(-x, -y, math.pi)]
    return [Pose(-y, x, math.pi / 2), Pose(y, -x, -math.pi / 2)]
