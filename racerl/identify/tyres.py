"""Tyre curves of a vehicle: force over load at the static load, pure slip, for drawing."""

from collections.abc import Sequence

import numpy as np
import pandas as pd
import torch
from numpy.typing import NDArray

from racerl.vehicle.ops import TORCH
from racerl.vehicle.parameter import replace_values
from racerl.vehicle.vehicle import STATE, Vehicle

Array = NDArray[np.float64]
SLIP = np.linspace(-0.6, 0.6, 121)  # slip ratio, or tangent of the slip angle


def tyre_curves(vehicle: Vehicle, names: Sequence[str], theta: Array, draws: Array) -> pd.DataFrame:
    """Return force/load over slip of both axles and directions, with the 95 % band over parameter draws (K, P).

    Columns: axle, direction (x, y), slip, start (the given vehicle), value, low, high.
    """
    start, value = forces(vehicle), forces(replace_values(vehicle, dict(zip(names, map(float, theta), strict=True))))
    spread = [forces(replace_values(vehicle, dict(zip(names, map(float, draw), strict=True)))) for draw in draws]
    parts = []
    for key in start:
        band = np.percentile([draw[key] for draw in spread], [2.5, 97.5], axis=0) if spread else [value[key]] * 2
        parts.append(
            pd.DataFrame(
                {
                    "axle": key[0],
                    "direction": key[1],
                    "slip": SLIP,
                    "start": start[key],
                    "value": value[key],
                    "low": band[0],
                    "high": band[1],
                }
            )
        )
    return pd.concat(parts, ignore_index=True)


def forces(vehicle: Vehicle) -> dict[tuple[str, str], Array]:
    """Return force/load over SLIP at the static load, by axle and direction."""
    slip = torch.as_tensor(SLIP)
    still = vehicle.motion([0.0 * slip] * len(STATE))
    curves = {}
    for axle, load in zip(("front", "rear"), vehicle.loads(still, TORCH), strict=True):
        tyre = getattr(vehicle, axle)
        F_x, _ = tyre.forces(slip, 0.0 * slip, load, vehicle.friction, TORCH)
        _, F_y = tyre.forces(0.0 * slip, slip, load, vehicle.friction, TORCH)
        curves[axle, "x"], curves[axle, "y"] = (F_x / load).numpy(), (F_y / load).numpy()
    return curves


def slips_covered(vehicle: Vehicle, states: Array) -> dict[str, list[float]]:
    """Return the range, 1 % to 99 %, of each slip ratio and tan α that measured states (8, K) reached."""
    rows = torch.as_tensor(states)
    slips = vehicle.slips(vehicle.motion(rows.unbind(0)), TORCH)
    return {
        name: [float(bound) for bound in np.percentile(values.numpy(), [1, 99])]
        for name, values in slips._asdict().items()
    }
