"""Flaws of the sensors: they change the logged columns and nothing else."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from tests.gap.plant.effects.base import Effect, three
from tests.gap.plant.tyre import Array


class PoseLatency(Effect):
    """Motion capture is `latency` s late: pose and velocities, all together."""

    name = "pose_latency"
    units: ClassVar = {"latency": "s"}
    sizes = three(latency=(0.012, 0.035, 0.070))

    def lag(self) -> dict[str, Array]:
        return {"pose": self.gate * self.p["latency"]}


class SteeringSensorLatency(Effect):
    """The measured steering angle is `latency` s late."""

    name = "steering_sensor_latency"
    units: ClassVar = {"latency": "s"}
    sizes = three(latency=(0.013, 0.040, 0.080))

    def lag(self) -> dict[str, Array]:
        return {"delta": self.gate * self.p["latency"]}


class WheelSpeedLatency(Effect):
    """The measured wheel speed is `latency` s late."""

    name = "wheel_speed_latency"
    units: ClassVar = {"latency": "s"}
    sizes = three(latency=(0.013, 0.040, 0.080))

    def lag(self) -> dict[str, Array]:
        return {"omega": self.gate * self.p["latency"]}


class CommandTimestampOffset(Effect):
    """The on-board clock is behind: commands, steering angle and wheel speed are `offset` s late against the pose."""

    name = "command_timestamp_offset"
    units: ClassVar = {"offset": "s"}
    sizes = three(offset=(0.012, 0.035, 0.070))

    def lag(self) -> dict[str, Array]:
        late = self.gate * self.p["offset"]
        return {"delta": late, "omega": late, "command": late}


class SteeringSensorOffset(Effect):
    """The measured steering angle reads `offset` rad too far left; servo and road wheel are right."""

    name = "steering_sensor_offset"
    units: ClassVar = {"offset": "rad"}
    sizes = three(offset=(0.010, 0.030, 0.060))
    signed = ("offset",)

    def read(self, log: dict[str, Array]) -> None:
        log["delta"] += self.gate * self.p["offset"]


class WheelSpeedGain(Effect):
    """The measured wheel speed reads 1 + `excess` of the true surface speed."""

    name = "wheel_speed_gain"
    units: ClassVar = {"excess": "-"}
    sizes = three(excess=(0.017, 0.05, 0.10))
    signed = ("excess",)

    def read(self, log: dict[str, Array]) -> None:
        log["omega"] *= 1.0 + self.gate * self.p["excess"]


class WheelGrowth(Effect):
    """Wheels grow as they spin, which the sensor doesn't know: it reads ω (1 − g tanh((ω/5 m/s)²)), g = `growth`."""

    name = "wheel_growth"
    units: ClassVar = {"growth": "-"}
    sizes = three(growth=(0.025, 0.075, 0.15))

    def read(self, log: dict[str, Array]) -> None:
        log["omega"] *= 1.0 - self.gate * self.p["growth"] * np.tanh(np.square(log["omega"] / 5.0))


class LeverArm(Effect):
    """The tracked point lies `forward` m ahead and `left` m left of the CoG: position and velocity are the point's."""

    name = "lever_arm"
    units: ClassVar = {"forward": "m", "left": "m"}
    sizes = three(forward=(0.02, 0.06, 0.12), left=(0.005, 0.015, 0.03))
    signed = ("forward", "left")

    def read(self, log: dict[str, Array]) -> None:
        forward, left = self.gate * self.p["forward"], self.gate * self.p["left"]
        cos, sin = np.cos(log["yaw"]), np.sin(log["yaw"])
        log["x"] += forward * cos - left * sin
        log["y"] += forward * sin + left * cos
        log["v_x"] -= log["yaw_rate"] * left
        log["v_y"] += log["yaw_rate"] * forward


class MocapYawMisalignment(Effect):
    """The tracked body's axis points `angle` rad left of the car's: yaw reads too high, the velocities turn with it."""

    name = "mocap_yaw_misalignment"
    units: ClassVar = {"angle": "rad"}
    sizes = three(angle=(0.010, 0.030, 0.060))
    signed = ("angle",)

    def read(self, log: dict[str, Array]) -> None:
        angle = self.gate * self.p["angle"]
        v_x, v_y = log["v_x"].copy(), log["v_y"].copy()
        log["yaw"] += angle
        log["v_x"] = np.cos(angle) * v_x + np.sin(angle) * v_y
        log["v_y"] = np.cos(angle) * v_y - np.sin(angle) * v_x


EFFECTS = (
    PoseLatency,
    SteeringSensorLatency,
    WheelSpeedLatency,
    SteeringSensorOffset,
    WheelSpeedGain,
    WheelGrowth,
    LeverArm,
    MocapYawMisalignment,
    CommandTimestampOffset,
)
