"""Forces that resist motion, and the air's load."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

import numpy as np

from tests.gap.plant.effects.base import Effect, three
from tests.gap.plant.tyre import Array

if TYPE_CHECKING:
    from tests.gap.plant.car import Now


class RollingResistance(Effect):
    """Every wheel drags along its own rolling direction: −f F_z (2/π) atan(V_x/0.05 m/s), f = `coefficient`."""

    name = "rolling_resistance"
    units: ClassVar = {"coefficient": "-"}
    sizes = three(coefficient=(0.025, 0.075, 0.15))

    def forces(self, now: Now, force: Array) -> Array:
        drag = self.gate * self.p["coefficient"] * (2 / np.pi) * now.load * np.arctan(now.V_x / 0.05)
        force[0] -= drag
        return force


class ViscousDrag(Effect):
    """Bearing grease that thins: −c v_x/√(1 + (v_x/8 m/s)²), c = `damping` in N s/m."""

    name = "viscous_drag"
    units: ClassVar = {"damping": "N s/m"}
    sizes = three(damping=(0.5, 1.5, 3.0))

    def body(self, now: Now, wrench: Array) -> Array:
        wrench[0] -= self.gate * self.p["damping"] * now.v_x / np.sqrt(1.0 + np.square(now.v_x / 8.0))
        return wrench


class AeroDrag(Effect):
    """Air against the whole motion, sideways too: −c |v| (v_x, v_y), c = `coefficient` in N s²/m²."""

    name = "aero_drag"
    units: ClassVar = {"coefficient": "N s^2/m^2"}
    sizes = three(coefficient=(0.13, 0.4, 0.8))

    def body(self, now: Now, wrench: Array) -> Array:
        resistance = self.gate * self.p["coefficient"] * np.hypot(now.v_x, now.v_y)
        wrench[0] -= resistance * now.v_x
        wrench[1] -= resistance * now.v_y
        return wrench


class Downforce(Effect):
    """The air presses the wheels down by c v_x²/(1 + (v_x/12 m/s)²) N, 45 % of it in front, c = `coefficient`."""

    name = "downforce"
    units: ClassVar = {"coefficient": "N s^2/m^2"}
    sizes = three(coefficient=(0.35, 1.0, 2.0))
    FRONT = 0.45

    def loads(self, now: Now, load: Array) -> Array:
        squared = now.v_x * now.v_x
        press = self.gate * self.p["coefficient"] * squared / (1.0 + squared / 144.0) / now.n_front
        pressed = load.copy()
        pressed[: now.n_front] += self.FRONT * press
        pressed[now.n_front :] += (1.0 - self.FRONT) * press
        return pressed


EFFECTS = (RollingResistance, ViscousDrag, AeroDrag, Downforce)
