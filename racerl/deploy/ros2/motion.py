"""Velocities from poses as they come in: the slope, at the newest pose, of a quadratic through the latest ones."""

import math
from collections import deque

import numpy as np

POSES = 11  # 0.1 s of a 100 Hz motion capture, as conf/car/twin.yaml has it
FEWEST = 5
PAUSE = 0.25  # s, after which poses before are another drive's


class Velocities:
    """Turns poses in the world into v_x, v_y (m/s) and yaw rate (rad/s) of the car."""

    def __init__(self) -> None:
        self._poses: deque[tuple[float, float, float, float]] = deque(maxlen=POSES)

    def add(self, time: float, x: float, y: float, yaw: float) -> tuple[float, float, float]:
        """Return the velocities with a new pose; NaN until there are enough."""
        if self._poses and not 0.0 < time - self._poses[-1][0] <= PAUSE:
            self._poses.clear()
        if self._poses:  # no jump where the angle wraps
            yaw = self._poses[-1][3] + math.remainder(yaw - self._poses[-1][3], 2.0 * math.pi)
        self._poses.append((time, x, y, yaw))
        if len(self._poses) < FEWEST:
            return math.nan, math.nan, math.nan
        poses = np.array(self._poses)
        ago = poses[:, 0] - time
        slope, *_ = np.linalg.lstsq(np.stack([ago, np.ones_like(ago), ago**2], axis=1), poses[:, 1:], rcond=None)
        v_x, v_y, yaw_rate = slope[0].tolist()
        cosine, sine = math.cos(yaw), math.sin(yaw)
        return cosine * v_x + sine * v_y, cosine * v_y - sine * v_x, yaw_rate
