"""Flaws of geometry and road: where the mass sits, and how the ground lies."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

import numpy as np

from tests.gap.plant.effects.base import GRAVITY, Effect, three
from tests.gap.plant.tyre import Array

if TYPE_CHECKING:
    from tests.gap.plant.car import Now, Plant


class CogLongitudinalOffset(Effect):
    """A load moved ahead by `offset` m: l_f shrinks, l_r grows, the static loads follow. The CoG is what is tracked."""

    name = "cog_longitudinal_offset"
    units: ClassVar = {"offset": "m"}
    sizes = three(offset=(0.012, 0.035, 0.065))
    signed = ("offset",)

    def reshape(self, cars: dict[str, Array]) -> None:
        cars["l_f"] = cars["l_f"] - self.gate * self.p["offset"]


class CogLateralOffset(Effect):
    """The CoG sits `offset` m right of the wheels' centre line, so that drive turns the car right: M = −e F_x."""

    name = "cog_lateral_offset"
    units: ClassVar = {"offset": "m"}
    sizes = three(offset=(0.007, 0.020, 0.04))
    signed = ("offset",)

    def reshape(self, cars: dict[str, Array]) -> None:
        cars["centre_line"] = cars["centre_line"] + self.gate * self.p["offset"]


class RoadSlope(Effect):
    """A tilted floor: m g sin(`angle`) downhill, in the world's direction `downhill` rad."""

    name = "road_slope"
    units: ClassVar = {"angle": "rad", "downhill": "rad"}
    sizes = three(angle=(0.013, 0.04, 0.08), downhill=0.7)
    signed = ("angle",)
    fixed = ("downhill",)

    def attach(self, plant: Plant) -> None:
        pull = self.gate * plant.cars["mass"] * GRAVITY * np.sin(self.p["angle"])
        self.east, self.north = pull * np.cos(self.p["downhill"]), pull * np.sin(self.p["downhill"])

    def body(self, now: Now, wrench: Array) -> Array:
        wrench[0] += now.cos_yaw * self.east + now.sin_yaw * self.north
        wrench[1] += now.cos_yaw * self.north - now.sin_yaw * self.east
        return wrench


class RoadBank(Effect):
    """The surface leans to one side along the track: m g sin(`angle`) to the left of the ground's direction of travel.

    The ground gives that direction at every place, whichever way the car drives (see `track`).
    """

    name = "road_bank"
    units: ClassVar = {"angle": "rad"}
    sizes = three(angle=(0.013, 0.04, 0.08))
    signed = ("angle",)

    def attach(self, plant: Plant) -> None:
        self.pull = self.gate * plant.cars["mass"] * GRAVITY * np.sin(self.p["angle"])
        self.lean = plant.lean

    def tick(self, now: Now) -> None:
        self.east, self.north = self.pull * self.lean(now.x, now.y)

    def body(self, now: Now, wrench: Array) -> Array:
        wrench[0] += now.cos_yaw * self.east + now.sin_yaw * self.north
        wrench[1] += now.cos_yaw * self.north - now.sin_yaw * self.east
        return wrench


EFFECTS = (CogLongitudinalOffset, CogLateralOffset, RoadSlope, RoadBank)
