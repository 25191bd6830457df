"""Keys, sticks and the current limit turn into commands."""

import pygame
import pytest
import torch
from pygame.event import Event

from racerl.assemble import Car
from racerl.config import compose_settings
from racerl.drive.controls import AXIS_MAX, KEYS, STEERING_RATE, Gamepad, Keyboard, choose_hands, requests
from racerl.drive.hands import Request
from racerl.drive.pedals import STEP, MotorCurrent, WheelSpeed, create_pedal
from racerl.drive.seat import Seat
from racerl.drive.session import Session
from racerl.drive.world import build
from racerl.errors import ConfigError
from racerl.evaluate.drive import Recorder
from racerl.registry import construct

DT = 0.02


def press(hands, *keys, up=False):
    """Post keys to pygame's queue and let the hands take what comes out of it."""
    for key in keys:
        pygame.event.post(Event(pygame.KEYUP if up else pygame.KEYDOWN, key=key))
    events = pygame.event.get()
    hands.take(events)
    return requests(events)


def hold(hands, steps):
    for _ in range(steps):
        held = hands.hold()
    return held


def seat(*words):
    settings = compose_settings("drive", words)
    race = build(settings, construct(Car, settings["car"], "car"), 0)
    session = Session(race.track.length, race.timing.dt, 2, float(race.travelled))
    hands = Keyboard(race.timing.dt)
    return Seat(race, session, hands, create_pedal(race, settings["current_limit"]), None, Recorder(race, [0]))


def test_steering_keys_are_rate_limited_and_centre_themselves(window):
    hands = Keyboard(DT)
    press(hands, pygame.K_LEFT)
    assert hold(hands, 1).steering == pytest.approx(STEERING_RATE * DT)  # left is positive
    assert hold(hands, 100).steering == 1.0
    press(hands, pygame.K_LEFT, up=True)
    assert 0.0 < hold(hands, 1).steering < 1.0 - STEERING_RATE * DT  # back faster than out
    assert hold(hands, 100).steering == 0.0
    press(hands, pygame.K_d)
    assert hold(hands, 100).steering == -1.0
    press(hands, pygame.K_a)  # both: the middle
    assert hold(hands, 100).steering == 0.0


def test_pedal_keys(window):
    hands = Keyboard(DT)
    press(hands, pygame.K_w)
    assert 0.0 < hold(hands, 1).pedal < hold(hands, 1).pedal and hold(hands, 100).pedal == 1.0
    press(hands, pygame.K_w, up=True)
    press(hands, pygame.K_DOWN)
    assert hold(hands, 100).pedal == -1.0


def test_keys_ask_for_things(window):
    hands = Keyboard(DT)
    assert press(hands, pygame.K_RETURN, pygame.K_UP, pygame.K_p) == [Request.START, Request.PAUSE]
    assert set(KEYS.values()) == set(Request)
    pygame.event.post(Event(pygame.QUIT))
    pygame.event.post(Event(pygame.CONTROLLERBUTTONDOWN, button=pygame.CONTROLLER_BUTTON_A))
    assert requests(pygame.event.get()) == [Request.QUIT, Request.START]


def test_a_gamepad_is_read_in_its_signs():
    class Pad:
        def __init__(self):
            self.axes = {}

        def get_axis(self, axis):
            return round(self.axes.get(axis, 0.0) * AXIS_MAX)

    pad = Pad()
    hands = Gamepad(pad)
    assert hands.hold() == (0.0, 0.0)
    pad.axes = {pygame.CONTROLLER_AXIS_LEFTX: 1.0, pygame.CONTROLLER_AXIS_TRIGGERRIGHT: 0.5}
    assert hands.hold() == pytest.approx((-1.0, 0.5), abs=1e-4)  # to the right is negative
    pad.axes = {pygame.CONTROLLER_AXIS_LEFTX: -0.5, pygame.CONTROLLER_AXIS_TRIGGERLEFT: 1.0}
    assert 0.4 < hands.hold().steering < 0.5 and hands.hold().pedal == -1.0
    pad.axes = {pygame.CONTROLLER_AXIS_LEFTX: 0.05}  # a stick that does not rest in its middle
    assert hands.hold().steering == 0.0


def test_without_a_gamepad_auto_is_the_keyboard(window):
    seated = seat()
    assert choose_hands("auto", seated.race, seated.session).name == "keyboard"
    with pytest.raises(ConfigError, match="none was found"):
        choose_hands("gamepad", seated.race, seated.session)
    with pytest.raises(ConfigError, match="did you mean keyboard"):
        choose_hands("keybord", seated.race, seated.session)


def test_nobody_drives_a_window_that_cannot_be_seen(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "offscreen")
    pygame.display.init()
    seated = seat()
    with pytest.raises(ConfigError, match="no display was found; without one, input=script drives"):
        choose_hands("keyboard", seated.race, seated.session)
    assert choose_hands("script", seated.race, seated.session).name == "script"
    pygame.quit()


def test_keys_move_the_limit_inside_the_motor_s(window):
    seated = seat("sim=motor_current", "current_limit=20")
    for key, limits in ((pygame.K_PLUS, (25.0, 60.0)), (pygame.K_MINUS, (55.0, STEP))):
        seen = []
        for _ in range(20):
            for request in press(seated.hands, key):
                seated.grant(request)
            seen.append(seated.pedal.limit)
        assert (seen[0], seen[-1]) == limits


def test_a_small_motor_bounds_the_limit():
    assert seat("sim=motor_current", "vehicle=jetracer").pedal.limit == 20.0
    assert MotorCurrent(30.0, 100.0, 60.0).greatest == 60.0


def test_the_pedal_becomes_a_current_within_the_limit(window):
    seated = seat("sim=motor_current", "current_limit=20")
    press(seated.hands, pygame.K_UP, pygame.K_LEFT)
    seated.held = hold(seated.hands, 100)
    command = seated.race.action.command(seated.act(seated.race), seated.race.command, DT)
    assert command[:, 0].tolist() == pytest.approx([0.5, 20.0])  # rad, A
    seated.grant(Request.MORE)
    assert float(seated.act(seated.race)[0, 1]) * 60.0 == pytest.approx(25.0)


def test_braking_ends_at_a_standstill():
    pedal = MotorCurrent(30.0, 60.0, 60.0)
    assert pedal.drive(-1.0, 3.0) == -0.5 and pedal.drive(-1.0, 0.25) == -0.25
    assert pedal.drive(-1.0, 0.0) == 0.0 and pedal.drive(-1.0, -1.0) == 0.0 and pedal.drive(1.0, 0.0) == 0.5


def test_in_wheel_speed_mode_a_released_pedal_keeps_the_speed(window):
    seated = seat()
    assert isinstance(seated.pedal, WheelSpeed)
    press(seated.hands, pygame.K_UP)
    for _ in range(15):
        seated.held = seated.hands.hold()
        seated.step()
    press(seated.hands, pygame.K_UP, up=True)
    hold(seated.hands, 20)
    reached = float(seated.race.command[1])
    for _ in range(20):
        seated.held = seated.hands.hold()
        seated.step()
    # 5 m/s² for 0.1 s, after the 0.2 s that the pedal takes to go down, from 0.01 m/s
    assert reached == pytest.approx(0.01 + 5 * (0.1 + 0.02 * 5.5)) and float(seated.race.command[1]) == pytest.approx(
        reached
    )
    assert torch.isfinite(seated.race.state).all()
