"""The log of a drive: 100 Hz columns with white noise, as motion capture and the car's own computer would give them.

x, y 1 mm; yaw 2 mrad; v_x, v_y 0.02 m/s; yaw rate 0.02 rad/s; delta 2 mrad; omega 0.02 m/s, all × a factor; commands
are exact. With differentiated velocities these come from the noisy pose by Savitzky–Golay instead. Of `SENSORS` each
gives a log something that real ones have.
"""

from collections.abc import Callable

import numpy as np
import pandas as pd
from scipy.signal import butter, filtfilt, savgol_filter

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
MOTION = ("x", "y", "yaw", "v_x", "v_y", "yaw_rate")
BEND = 1e-3  # m, root mean square by which space is bent in x and in y
WAVES = 3  # that bend it
WAVELENGTH = 4.0  # m, typical
TICKS: dict[str, float] = {"delta": 2 * np.pi / 4096, "omega": 0.02}  # rad and m/s, of encoders
CUT_OFF = 15.0  # Hz, of a Butterworth filter of second order, run both ways

Channels = dict[str, Array]


def add_noise(channels: Channels, factor: float, rng: np.random.Generator) -> Channels:
    """The channels of one run of one car, (n,) each, with noise."""
    noisy = dict(channels)
    for name, deviation in NOISE.items():
        noisy[name] = channels[name] + factor * deviation * rng.standard_normal(len(channels[name]))
    return noisy


def ideal(channels: Channels, rng: np.random.Generator) -> Channels:
    """Noise alone."""
    return channels


def bent(channels: Channels, rng: np.random.Generator) -> Channels:
    """Poses by a motion capture that is wrong by a millimetre, smoothly over metres, like a poor calibration."""
    x, y = channels["x"], channels["y"]
    waves, phases = rng.normal(size=(2, WAVES, 2)), rng.uniform(0.0, 2 * np.pi, (2, WAVES, 1))
    phase = 2 * np.pi / WAVELENGTH * np.einsum("awk,kn->awn", waves, np.stack([x, y])) + phases
    off = BEND * np.sqrt(2 / WAVES) * np.sin(phase).sum(axis=1)
    return channels | {"x": x + off[0], "y": y + off[1]}


def coarse(channels: Channels, rng: np.random.Generator) -> Channels:
    """Encoders that count ticks."""
    return channels | {name: np.round(channels[name] / tick) * tick for name, tick in TICKS.items()}


def filtered(channels: Channels, rng: np.random.Generator) -> Channels:
    """Motion filtered after the drive, late in nothing."""
    b, a = butter(2, CUT_OFF, fs=1 / SAMPLE_PERIOD)
    return channels | {name: filtfilt(b, a, channels[name]) for name in MOTION}


def sparse(channels: Channels, rng: np.random.Generator) -> Channels:
    """Every second sample: 50 Hz."""
    return {name: values[::2] for name, values in channels.items()}


SENSORS: dict[str, Callable[[Channels, np.random.Generator], Channels]] = {
    "ideal": ideal,
    "bent": bent,
    "coarse": coarse,
    "filtered": filtered,
    "sparse": sparse,
}


def differentiate(channels: Channels, period: float = SAMPLE_PERIOD) -> Channels:
    """The channels with velocity and yaw rate worked out from the pose, sampled every `period` in s."""
    rate = {k: savgol_filter(channels[k], WINDOW, 3, deriv=1, delta=period) for k in ("x", "y", "yaw")}
    cos, sin = np.cos(channels["yaw"]), np.sin(channels["yaw"])
    return channels | {
        "v_x": cos * rate["x"] + sin * rate["y"],
        "v_y": cos * rate["y"] - sin * rate["x"],
        "yaw_rate": rate["yaw"],
    }


def frame(run: int, channels: Channels) -> pd.DataFrame:
    """One run as rows of the log."""
    t = channels["t"]
    return pd.DataFrame({"t": t, "run": np.full(len(t), run)} | {name: channels[name] for name in CHANNELS})
