"""What a regression's terms leave over: bounded forces by a small network, of no physical name.

Formula: F_x/m, F_y/m and M_z/(10 J) gain A tanh(Σ_j c_j h_j/A), h_j = tanh(b_j + Σ_i w_ji z_i) over UNITS units;
    z_i are tanh(v_x/3), tanh(δ/0.2), tanh(r/3), tanh(v_y/0.5) and that of ten times the slip ratio.
Source: a network with one hidden layer, its prior where it starts, without force; not meant to be understood.
In data: `racerl gap` offers it beside `learned_residual` where that leaves something that a network takes away.
Excited by: whatever the log holds; beyond its greatest speed, steering and yaw rate it fades.
Confused with: nothing, since it stands for everything.
"""

from dataclasses import dataclass, make_dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from racerl.vehicle.effects._fading import Fading, scaled
from racerl.vehicle.ops import Ops, Scalar
from racerl.vehicle.parameter import parameter

if TYPE_CHECKING:
    from racerl.vehicle.vehicle import Forces, Motion, Wrench

UNITS = 6
INPUTS = ("one", "speed", "steer", "turn", "drift", "slip")
OUTPUTS = ("ahead", "aside", "about")


def _weights() -> list[tuple[str, Any, Any]]:
    """Return the fields: into the units from drawn starts, which tells units apart, and out of them from zero."""
    starts = np.random.default_rng(0).normal(size=(UNITS, len(INPUTS))).round(3).tolist()
    within = [
        (f"unit_{j}_{name}", Scalar, parameter("", -10.0, 10.0, f"unit {j}: weight of {name}", starts[j][i]))
        for j in range(UNITS)
        for i, name in enumerate(INPUTS)
    ]
    out = [
        (f"{name}_{j}", Scalar, parameter("", -30.0, 30.0, f"{name}: weight of unit {j}", 0.0))
        for name in OUTPUTS
        for j in range(UNITS)
    ]
    return [*within, *out]


Weights: Any = make_dataclass("Weights", _weights(), bases=(Fading,), frozen=True, kw_only=True)


@dataclass(frozen=True, kw_only=True)
class LearnedNetwork(Weights):
    """Weights; no force unless learned."""

    def wrench(self, wrench: "Wrench", forces: "Forces", motion: "Motion", ops: Ops) -> "Wrench":
        """Add what was learned."""
        seen = (1.0, *scaled(motion, ops))
        units = [
            ops.tanh(sum(getattr(self, f"unit_{j}_{name}") * z for name, z in zip(INPUTS, seen, strict=True)))
            for j in range(UNITS)
        ]
        learned = [sum(getattr(self, f"{name}_{j}") * unit for j, unit in enumerate(units)) for name in OUTPUTS]
        return self.push(wrench, motion, learned, ops)
