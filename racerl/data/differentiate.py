"""Velocities from poses, as a motion-capture pipeline makes them: Savitzky–Golay, then turned into the body frame."""

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_filter

Array = NDArray[np.float64]


def velocities(x: Array, y: Array, yaw: Array, dt: float, window: int, order: int) -> tuple[Array, Array, Array]:
    """Return (v_x, v_y, yaw_rate) in the body frame for one run; m, rad and s in, each of shape (rows,).

    `window` counts samples, `order` is the polynomial's. The yaw may be wrapped.
    """
    yaw = np.unwrap(yaw)
    rates = savgol_filter(np.stack([x, y, yaw]), window, order, deriv=1, delta=dt, mode="interp")
    # the filter's own smoothing of the heading: its noise would turn speed into sideways motion
    heading = savgol_filter(yaw, window, order, mode="interp")
    sin, cos = np.sin(heading), np.cos(heading)
    return cos * rates[0] + sin * rates[1], cos * rates[1] - sin * rates[0], rates[2]
