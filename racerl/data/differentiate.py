"""Velocities from poses: Savitzky–Golay derivatives in the world, turned into the car's frame.

    v_x =  ẋ cos ψ + ẏ sin ψ,   v_y = −ẋ sin ψ + ẏ cos ψ,   r = ψ̇

ψ is the smoothed heading. At a run's ends the polynomial of the first and last window is used.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_filter

Array = NDArray[np.float64]


def velocities(x: Array, y: Array, yaw: Array, dt: float, window: int, order: int) -> tuple[Array, Array, Array]:
    """Return (v_x, v_y, yaw_rate) of one run of poses, each (rows,) with rows ≥ window; yaw may be wrapped."""
    turned = np.unwrap(yaw)
    x_dot, y_dot, yaw_rate = (
        savgol_filter(signal, window, order, deriv=1, delta=dt, mode="interp") for signal in (x, y, turned)
    )
    smooth = savgol_filter(turned, window, order, mode="interp")
    cos, sin = np.cos(smooth), np.sin(smooth)
    return x_dot * cos + y_dot * sin, -x_dot * sin + y_dot * cos, yaw_rate


def slope(signal: Array, dt: float, window: int = 9, order: int = 2) -> Array:
    """Return the smoothed time derivative of one run's channel, (rows,); zero for a run shorter than the window."""
    if len(signal) < window:
        return np.zeros_like(signal)
    return np.asarray(savgol_filter(signal, window, order, deriv=1, delta=dt, mode="interp"))


def smoothed(signal: Array, window: int = 9, order: int = 2) -> Array:
    """Return one run's channel smoothed, (rows,); as it is for a run shorter than the window."""
    return signal if len(signal) < window else np.asarray(savgol_filter(signal, window, order, mode="interp"))
