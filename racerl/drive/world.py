"""The world of a drive: a race of one car, which only a crash interrupts."""

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

from racerl.assemble import Car, build_timing
from racerl.env.race import YAW, Race, X, Y
from racerl.evaluate.evaluate import build_evaluation_race, combine

RUN_UP = 1.0  # m before the line, where the car stands at first
ACTIONS = {"wheel_speed": "speed_rate", "motor_current": "current"}


def build(settings: Mapping[str, Any], car: Car, seed: int) -> Race:
    """Return a race of one car, which stands a little before the line."""
    sim = settings["sim"]
    car.has_actuators(sim)  # what a motor needs is checked there
    # the observation is not looked at; the smallest one is
    world = {**settings, "obs": {"name": "progress"}, "action": {"name": ACTIONS.get(sim["drive"], "speed_rate")}}
    build_timing(settings)  # its numbers are checked there
    race = build_evaluation_race(combine(world, world, car), [seed], torch.device("cpu"), car.estimate)
    put(race, race.frame.wrap(torch.tensor([-RUN_UP])))
    return race


def put(race: Race, s: Tensor) -> None:
    """Put the car at rest on the centreline at s (1,), along it."""
    still = torch.zeros_like(s)
    state = torch.zeros_like(race.state)
    state[X], state[Y], state[YAW] = race.frame.position(s, still)
    race.put(torch.zeros(1, dtype=torch.long), state, torch.stack([still, race.action.initial(still)]))
