"""Rivals of the policy, one file each; module `pure_pursuit` holds `PurePursuit`, with the keys of its YAML.

A controller is prepared with what a team would know, the model of its car and the track, and then drives a race through
the action of a policy, seeing what a policy sees.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from racerl import registry
from racerl.control import Controller
from racerl.documents import read_yaml
from racerl.env.actions import Action
from racerl.env.race import Timing
from racerl.track.track import Track
from racerl.vehicle.vehicle import Vehicle


@dataclass(frozen=True)
class Known:
    """What is known before the start."""

    vehicle: Vehicle  # the model, whatever the car does beyond it
    track: Track
    action: Action
    timing: Timing


class Rival(Controller, Protocol):
    """A controller that tells what happened to it."""

    @property
    def facts(self) -> Mapping[str, Any]:
        """What its results say beside the laps."""


class Design(Protocol):
    """A controller's settings."""

    @property
    def delay(self) -> float:
        """Time from what it sees to when its command acts, in s."""

    def prepare(self, known: Known) -> Rival:
        """Return the controller, ready to drive any number of cars; raise OptimumError where it finds no line."""


def create_controller(settings: Mapping[str, Any]) -> Design:
    """Build the controller that `settings["name"]` names, or that of the file that `settings["file"]` names."""
    import racerl.control.controllers as package

    design: Design = registry.create(package, read_controller(settings))
    return design


def read_controller(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings, with those of `settings["file"]` under them if there is one."""
    own = {key: value for key, value in settings.items() if key != "file"}
    return {**read_yaml(Path(settings["file"])), **own} if "file" in settings else own
