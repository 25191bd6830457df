"""Keyboard and gamepad, through pygame: keys held and sticks moved become steering and pedal, keys pressed requests.

A key is all or nothing, a hand is not: steering and pedal move towards what the keys ask for at limited rates, and back
to the middle, faster, when they are released.
"""

from collections.abc import Sequence
from typing import Protocol

import pygame
from pygame.event import Event

from racerl.drive.hands import Hands, Hold, Request, Script, clip
from racerl.drive.session import Session
from racerl.env.race import Race
from racerl.errors import ConfigError, suggest

LEFT, RIGHT = (pygame.K_LEFT, pygame.K_a), (pygame.K_RIGHT, pygame.K_d)
UP, DOWN = (pygame.K_UP, pygame.K_w), (pygame.K_DOWN, pygame.K_s)
KEYS = {
    pygame.K_RETURN: Request.START,
    pygame.K_KP_ENTER: Request.START,
    pygame.K_p: Request.PAUSE,
    pygame.K_r: Request.PUT_BACK,
    pygame.K_PLUS: Request.MORE,
    pygame.K_EQUALS: Request.MORE,  # the same key without shift on many keyboards
    pygame.K_KP_PLUS: Request.MORE,
    pygame.K_PAGEUP: Request.MORE,
    pygame.K_MINUS: Request.LESS,
    pygame.K_KP_MINUS: Request.LESS,
    pygame.K_PAGEDOWN: Request.LESS,
    pygame.K_ESCAPE: Request.QUIT,
}
BUTTONS = {
    pygame.CONTROLLER_BUTTON_A: Request.START,
    pygame.CONTROLLER_BUTTON_START: Request.PAUSE,
    pygame.CONTROLLER_BUTTON_B: Request.PUT_BACK,
    pygame.CONTROLLER_BUTTON_RIGHTSHOULDER: Request.MORE,
    pygame.CONTROLLER_BUTTON_LEFTSHOULDER: Request.LESS,
    pygame.CONTROLLER_BUTTON_BACK: Request.QUIT,
}
STEERING_RATE, CENTRING_RATE = 4.0, 7.0  # full locks per second
PEDAL_RATE, RELEASE_RATE = 5.0, 10.0  # full pedals per second
AXIS_MAX = 32767.0
DEAD_ZONE = 0.08  # of a stick's way
INPUTS = ("auto", "keyboard", "gamepad", "script")


def requests(events: Sequence[Event]) -> list[Request]:
    """Return what keys, buttons and the window's cross ask for."""
    asked = []
    for event in events:
        if event.type == pygame.KEYDOWN and event.key in KEYS:
            asked.append(KEYS[event.key])
        elif event.type == pygame.CONTROLLERBUTTONDOWN and event.button in BUTTONS:
            asked.append(BUTTONS[event.button])
        elif event.type == pygame.QUIT:
            asked.append(Request.QUIT)
    return asked


class Keyboard:
    """Arrows or W A S D."""

    name, live = "keyboard", True

    def __init__(self, dt: float) -> None:
        self._dt = dt  # s
        self._down: set[int] = set()
        self._hold = Hold(0.0, 0.0)

    def take(self, events: Sequence[Event]) -> list[Request]:
        """Follow which keys are down."""
        for event in events:
            if event.type == pygame.KEYDOWN:
                self._down.add(event.key)
            elif event.type == pygame.KEYUP:
                self._down.discard(event.key)
        return []

    def hold(self) -> Hold:
        """Move on towards what the keys ask for."""
        steering = _towards(self._hold.steering, self._way(LEFT, RIGHT), STEERING_RATE, CENTRING_RATE, self._dt)
        pedal = _towards(self._hold.pedal, self._way(UP, DOWN), PEDAL_RATE, RELEASE_RATE, self._dt)
        self._hold = Hold(steering, pedal)
        return self._hold

    def _way(self, more: Sequence[int], less: Sequence[int]) -> float:
        return float(not self._down.isdisjoint(more)) - float(not self._down.isdisjoint(less))


def _towards(value: float, goal: float, rate: float, back: float, dt: float) -> float:
    """Return the value after a step towards the goal, at `back` per second while that leads to the middle."""
    step = dt * (back if value * goal <= 0.0 and value != 0.0 else rate)
    return value + min(max(goal - value, -step), step)


class Pad(Protocol):
    """What is used of pygame's controller."""

    def get_axis(self, axis: int, /) -> int:
        """Return the place of an axis: −32768 … 32767 of a stick, 0 … 32767 of a trigger."""


class Gamepad:
    """Left stick and triggers."""

    name, live = "gamepad", True

    def __init__(self, pad: Pad) -> None:
        self._pad = pad

    def take(self, events: Sequence[Event]) -> list[Request]:
        """Ask for nothing: buttons are read with the keys."""
        return []

    def hold(self) -> Hold:
        """Return where stick and triggers are."""
        stick = clip(self._axis(pygame.CONTROLLER_AXIS_LEFTX))
        size = max(0.0, abs(stick) - DEAD_ZONE) / (1.0 - DEAD_ZONE)
        throttle, brake = (
            self._axis(axis) for axis in (pygame.CONTROLLER_AXIS_TRIGGERRIGHT, pygame.CONTROLLER_AXIS_TRIGGERLEFT)
        )
        return Hold(-size if stick > 0.0 else size, clip(throttle - brake))

    def _axis(self, axis: int) -> float:
        return self._pad.get_axis(axis) / AXIS_MAX


def find_pad() -> Pad | None:
    """Return the first gamepad that SDL knows the buttons of, or None."""
    from pygame._sdl2 import controller

    controller.init()
    known = [i for i in range(controller.get_count()) if controller.is_controller(i)]
    return controller.Controller(known[0]) if known else None


def choose_hands(kind: str, race: Race, session: Session) -> Hands:
    """Return the hands for one of INPUTS; raise ConfigError when there are none such."""
    if kind not in INPUTS:
        raise ConfigError(f"unknown input '{kind}'{suggest(kind, INPUTS)}")
    if kind == "script":
        return Script(race, session)
    if pygame.display.get_driver() == "offscreen":
        raise ConfigError("no display was found; without one, input=script drives")
    pad = find_pad() if kind != "keyboard" else None
    if pad is None and kind == "gamepad":
        raise ConfigError("input = gamepad: none was found; plug one in, or use input=keyboard")
    return Gamepad(pad) if pad else Keyboard(race.timing.dt)
