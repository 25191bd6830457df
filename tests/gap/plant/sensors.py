"""The log of a drive: 100 Hz columns with white noise, as motion capture and the car's own computer would give them.

x, y 1 mm; yaw 2 mrad; v_x, v_y 0.02 m/s; yaw rate 0.02 rad/s; delta 2 mrad; omega 0.02 m/s, all × a factor; commands
are exact. With differentiated velocities these come from the noisy pose by Savitzky–Golay instead.
"""

import numpy as np
import pandas as pd
from scipy.signal import savgol_filter

from tests.gap.plant.tyre import Array

CHANNELS = ("x", "y", "yaw", "v_x", "v_y", "yaw_rate", "delta", "omega", "delta_ref", "omega_ref")
COLUMNS = ("t", "run", *CHANNELS)
GROUPS: dict[str, slice] = {"pose": slice(0, 6), "delta": slice(6, 7), "omega": slice(7, 8), "command": slice(8, 10)}
NOISE: dict[str, float] = {
    "x": 1e-3,
    "y": 1e-3,
    "yaw": 2e-3,
    "v_x": 0.02,
    "v_y": 0.02,
    "yaw_rate": 0.02,
    "delta": 2e-3,
    "omega": 0.02,
}
SAMPLE_PERIOD = 0.01  # s
WINDOW = 11  # samples of the Savitzky–Golay filter, third order


def add_noise(channels: dict[str, Array], factor: float, rng: np.random.Generator) -> dict[str, Array]:
    """The channels of one run of one car, (n,) each, with noise."""
    noisy = dict(channels)
    for name, deviation in NOISE.items():
        noisy[name] = channels[name] + factor * deviation * rng.standard_normal(len(channels[name]))
    return noisy


def differentiate(channels: dict[str, Array]) -> dict[str, Array]:
    """The channels with velocity and yaw rate worked out from the pose."""
    rate = {k: savgol_filter(channels[k], WINDOW, 3, deriv=1, delta=SAMPLE_PERIOD) for k in ("x", "y", "yaw")}
    cos, sin = np.cos(channels["yaw"]), np.sin(channels["yaw"])
    return channels | {
        "v_x": cos * rate["x"] + sin * rate["y"],
        "v_y": cos * rate["y"] - sin * rate["x"],
        "yaw_rate": rate["yaw"],
    }


def frame(t: Array, run: int, channels: dict[str, Array]) -> pd.DataFrame:
    """One run as rows of the log."""
    return pd.DataFrame({"t": t, "run": np.full(len(t), run)} | {name: channels[name] for name in CHANNELS})
