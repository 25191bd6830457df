"""The window: track and car from above, and beside them what a driver reads while driving.

The whole track is fitted into the window. Wheels are coloured by the slip of their axle, √(κ² + α²): green while they
grip, red from the slip at which the published tyres grip most.
"""

import math
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from types import TracebackType

import numpy as np
import pygame
from numpy.typing import NDArray
from pygame import Surface, Vector2
from pygame.event import Event

from racerl.drive.hands import Hold
from racerl.errors import ConfigError
from racerl.track.track import Track
from racerl.vehicle.vehicle import Vehicle

VIEW, PANEL = (860, 720), 340  # pixels
EDGE, STRIP = 40, 60  # pixels left free round the track, and below it for messages
FINE = 2  # the track is drawn so much larger, then scaled down, for smooth edges
DASH = 0.2  # m
PEAK = 0.13  # slip at which the published tyres grip most
SHORTEST = 24.0  # pixels of wheelbase, so that a car is seen on a large track

GROUND, ASPHALT, LINE, DIM = (24, 28, 34), (62, 68, 77), (222, 226, 230), (128, 137, 150)
GREEN, YELLOW, RED, BLUE = (67, 190, 110), (240, 196, 60), (232, 76, 70), (78, 148, 236)
KEYS = (
    ("up, down or W, S", "throttle, brake"),
    ("left, right or A, D", "steer"),
    ("Enter", "start the counted laps"),
    ("P", "pause"),
    ("R", "back on the track (costs the lap)"),
    ("+, −", "current limit"),
    ("Esc", "quit; what was driven is kept"),
)
PAD = (
    ("right, left trigger", "throttle, brake"),
    ("left stick", "steer"),
    ("A", "start the counted laps"),
    ("Start", "pause"),
    ("B", "back on the track (costs the lap)"),
    ("right, left shoulder", "current limit"),
    ("Back", "quit; what was driven is kept"),
)
Colour = tuple[int, int, int]


@dataclass(frozen=True)
class Picture:
    """What is to be seen of one moment."""

    x: float  # m
    y: float  # m
    yaw: float  # rad
    speed: float  # m/s
    omega: float  # m/s
    delta: float  # rad
    slips: tuple[tuple[float, float], tuple[float, float]]  # (κ, α*) in front and at the rear
    hold: Hold
    mode: str
    title: str
    elapsed: float | None  # s, on this lap
    delta_to_best: float | None  # s
    last: str
    best: str
    message: str
    gamepad: bool


class Screen:
    """The open window; pygame is shut down when it closes."""

    def __init__(self, track: Track, vehicle: Vehicle) -> None:
        self._track = track
        self._wheelbase, self._arm = float(vehicle.wheelbase), float(vehicle.arm)

    def __enter__(self) -> "Screen":
        # a flat picture needs no GPU, whose driver keeps a cache that kills the process on a full disk
        os.environ.setdefault("SDL_FRAMEBUFFER_ACCELERATION", "0")
        os.environ.setdefault("XDG_RUNTIME_DIR", os.devnull)  # without it Wayland's library writes to the terminal
        try:
            pygame.display.init()
            pygame.font.init()
            self.surface = pygame.display.set_mode((VIEW[0] + PANEL, VIEW[1]))
        except pygame.error as error:
            pygame.quit()
            raise ConfigError(f"no window can be opened ({error}); without a display: input=script") from error
        pygame.display.set_caption(f"racerl drive: {self._track.name}")
        self._clock = pygame.time.Clock()
        self._fonts = {size: pygame.font.Font(None, size) for size in (20, 24, 30, 44, 72)}
        self._fit()
        self._background = self._draw_track()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        pygame.quit()

    def events(self) -> list[Event]:
        """Return what has happened to the window since the last call."""
        return pygame.event.get()

    def wait(self, dt: float) -> None:
        """Wait until `dt` seconds have passed since the last call."""
        self._clock.tick(round(1.0 / dt))

    def draw(self, picture: Picture) -> None:
        """Show one moment."""
        self.surface.blit(self._background, (0, 0))
        self._draw_car(picture)
        self._draw_panel(picture)
        if picture.message:
            self._draw_message(picture.message)
        pygame.display.flip()

    def _fit(self) -> None:
        """Find the scale and the place of the track in the window."""
        x, y = (np.concatenate(sides) for sides in zip(self._track.boundary(1), self._track.boundary(-1), strict=True))
        width, height = float(np.ptp(x)), float(np.ptp(y))
        self._scale = min((VIEW[0] - 2 * EDGE) / width, (VIEW[1] - STRIP - EDGE) / height)  # pixels per m
        self._centre = float(x.min()) + width / 2, float(y.min()) + height / 2

    def _pixel(self, x: float, y: float) -> Vector2:
        """Return the place of a point of the world in the window, y upwards."""
        across, up = (x - self._centre[0]) * self._scale, (y - self._centre[1]) * self._scale
        return Vector2(VIEW[0] / 2 + across, (VIEW[1] - STRIP + EDGE) / 2 - up)

    def _pixels(self, x: Iterable[float], y: Iterable[float]) -> list[Vector2]:
        return [FINE * self._pixel(*point) for point in zip(x, y, strict=True)]

    def _draw_track(self) -> Surface:
        track, large = self._track, Surface((FINE * VIEW[0], FINE * VIEW[1]))
        large.fill(GROUND)
        left, right = self._pixels(*track.boundary(1)), self._pixels(*track.boundary(-1))
        for i in range(len(left)):
            pygame.draw.polygon(large, ASPHALT, [left[i - 1], left[i], right[i], right[i - 1]])
        for side in (left, right):
            pygame.draw.lines(large, LINE, True, side, 2 * FINE)
        middle, dash = self._pixels(track.x, track.y), max(1, round(DASH / track.spacing))
        for i in range(0, len(middle) - dash, 2 * dash):
            pygame.draw.lines(large, DIM, False, middle[i : i + dash + 1], 2 * FINE)
        pygame.draw.line(large, YELLOW, left[0], right[0], 4 * FINE)
        background = Surface((VIEW[0] + PANEL, VIEW[1]))
        background.fill(_darker(GROUND))
        background.blit(pygame.transform.smoothscale(large, VIEW), (0, 0))
        return background

    def _draw_car(self, picture: Picture) -> None:
        """Draw body and wheels about the centre of gravity, to scale while that is large enough."""
        length = max(self._scale * self._wheelbase, SHORTEST)  # pixels of wheelbase
        front, rear = length * self._arm / self._wheelbase, length * (self._arm / self._wheelbase - 1.0)
        centre, across = self._pixel(picture.x, picture.y), 0.38 * length
        for axle, angle, slip in ((front, picture.delta, picture.slips[0]), (rear, 0.0, picture.slips[1])):
            for side in (across, -across):
                hub = centre + Vector2(axle, -side).rotate_rad(-picture.yaw)
                wheel = _box(-0.17 * length, 0.17 * length, 0.09 * length)
                self._polygon(wheel, hub, picture.yaw + angle, _slip_colour(*slip))
        self._polygon(_box(rear - 0.2 * length, front + 0.25 * length, 0.24 * length), centre, picture.yaw, BLUE)
        self._polygon(_box(front - 0.05 * length, front + 0.25 * length, 0.16 * length), centre, picture.yaw, LINE)

    def _polygon(self, points: NDArray[np.float64], centre: Vector2, yaw: float, colour: Colour) -> None:
        """Draw points (P, 2), in pixels forward and left of a centre, turned by yaw."""
        corners = [centre + Vector2(x, -y).rotate_rad(-yaw) for x, y in points.tolist()]
        pygame.draw.polygon(self.surface, colour, corners)
        pygame.draw.aalines(self.surface, colour, True, corners)

    def _draw_panel(self, picture: Picture) -> None:
        left, right = VIEW[0] + 20, VIEW[0] + PANEL - 20
        self._text(picture.title, (left, 20), 44, YELLOW)
        self._text(_seconds(picture.elapsed), (left, 66), 72)
        if picture.delta_to_best is not None:
            colour = GREEN if picture.delta_to_best <= 0.0 else RED
            self._text(f"{picture.delta_to_best:+.2f}".replace("-", "−"), (right, 76), 44, colour, right=True)
        for row, (name, text) in enumerate((("last lap", picture.last), ("best lap", picture.best))):
            self._text(name, (left, 126 + 26 * row), 24, DIM)
            self._text(text, (right, 126 + 26 * row), 24, right=True)

        self._text(f"{picture.speed:.2f}", (left, 196), 72)
        self._text("m/s", (left + 118, 220), 30, DIM)
        self._text(f"wheels {picture.omega:.2f} m/s", (right, 222), 24, DIM, right=True)
        self._text(picture.mode, (left, 252), 24, YELLOW)

        self._bar("steering", 286, -picture.hold.steering, BLUE, f"{picture.delta:+.2f} rad")
        pedal = picture.hold.pedal
        self._bar("pedal", 336, pedal, GREEN if pedal >= 0.0 else RED, f"{100 * pedal:+.0f} %")
        for row, (name, (kappa, alpha)) in enumerate(zip(("front slip", "rear slip"), picture.slips, strict=True)):
            size = math.hypot(kappa, alpha) / (2.0 * PEAK)
            numbers = f"ratio {kappa:+.2f}   angle {alpha:+.2f}"
            self._bar(name, 396 + 50 * row, size, _slip_colour(kappa, alpha), numbers, middle=False)

        for row, (key, meaning) in enumerate(PAD if picture.gamepad else KEYS):
            self._text(key, (left, 540 + 22 * row), 20)
            self._text(meaning, (right, 540 + 22 * row), 20, DIM, right=True)

    def _bar(self, name: str, top: int, share: float, colour: Colour, numbers: str, middle: bool = True) -> None:
        """Draw a share, −1 … 1 from the middle or 0 … 1 from the left, under its name and its numbers."""
        left, width = VIEW[0] + 20, PANEL - 40
        self._text(name, (left, top), 24, DIM)
        self._text(numbers.replace("-", "−"), (left + width, top), 24, right=True)
        pygame.draw.rect(self.surface, ASPHALT, (left, top + 20, width, 12), border_radius=4)
        start = left + width / 2 if middle else left
        end = start + min(max(share, -1.0), 1.0) * (left + width - start)
        filled = pygame.Rect(min(start, end), top + 20, abs(end - start), 12)
        pygame.draw.rect(self.surface, colour, filled, border_radius=4)
        tick = left + width / 2
        pygame.draw.line(self.surface, LINE, (tick, top + 18), (tick, top + 33))

    def _draw_message(self, message: str) -> None:
        text = self._fonts[30].render(message, True, LINE)
        place = text.get_rect(center=(VIEW[0] / 2, VIEW[1] - STRIP / 2))
        pygame.draw.rect(self.surface, _darker(GROUND), place.inflate(32, 16), border_radius=8)
        self.surface.blit(text, place)

    def _text(
        self, text: str, place: tuple[float, float], size: int, colour: Colour = LINE, *, right: bool = False
    ) -> None:
        image = self._fonts[size].render(text, True, colour)
        self.surface.blit(image, (place[0] - image.get_width() if right else place[0], place[1]))


def _box(back: float, front: float, half_width: float) -> NDArray[np.float64]:
    """Return the corners (4, 2) of a rectangle, forward and left."""
    return np.array([(front, half_width), (front, -half_width), (back, -half_width), (back, half_width)])


def _slip_colour(kappa: float, alpha: float) -> Colour:
    """Return green without slip, by way of yellow, to red at PEAK and beyond."""
    share = min(math.hypot(kappa, alpha) / PEAK, 1.0)
    return _mixed(GREEN, YELLOW, 2.0 * share) if share < 0.5 else _mixed(YELLOW, RED, 2.0 * share - 1.0)


def _mixed(one: Sequence[int], other: Sequence[int], share: float) -> Colour:
    red, green, blue = (round(a + share * (b - a)) for a, b in zip(one, other, strict=True))
    return red, green, blue


def _darker(colour: Colour) -> Colour:
    return _mixed(colour, (0, 0, 0), 0.3)


def _seconds(time: float | None) -> str:
    return "–" if time is None else f"{time:.2f}"
