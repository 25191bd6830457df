"""What no known effect explains, as bounded forces of no physical name; off where the log has not been.

Formula: F_x/m, F_y/m and M_z/(10 J) gain A tanh(Σ c_k φ_k/A); φ_k constants and products of tanh(v_x/3), tanh(δ/0.2),
    tanh(r/3), tanh(v_y/0.5) and the slip ratio that keep left and right alike; δ̇ and ω̇ likewise of the command's lead.
Source: a regression with a minimum-norm prior, of which the terms that the data ask for stay.
In data: `racerl gap` offers it where its verdict is unknown.
Excited by: whatever the log holds; beyond its greatest speed, steering and yaw rate it fades.
Confused with: nothing, since it stands for everything.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from racerl.vehicle.effects._fading import Fading, scaled
from racerl.vehicle.ops import Ops, Scalar
from racerl.vehicle.parameter import parameter

if TYPE_CHECKING:
    from racerl.vehicle.vehicle import Course, Forces, Motion, Wrench

MOST_STEERING, MOST_DRIVE = 3.0, 20.0  # rad/s and m/s²


def _weight(meaning: str) -> Scalar:
    value: Scalar = parameter("", -30.0, 30.0, meaning, 0.0)
    return value


@dataclass(frozen=True, kw_only=True)
class LearnedResidual(Fading):
    """Weights c, zero unless learned."""

    ahead_one: Scalar = _weight("F_x: constant")
    ahead_speed: Scalar = _weight("F_x: speed")
    ahead_speed_2: Scalar = _weight("F_x: speed squared")
    ahead_steer_2: Scalar = _weight("F_x: steering squared")
    ahead_turn_2: Scalar = _weight("F_x: yaw rate squared")
    ahead_slip: Scalar = _weight("F_x: slip ratio")
    ahead_slip_speed: Scalar = _weight("F_x: slip ratio times speed")
    aside_one: Scalar = _weight("F_y: constant")
    aside_steer: Scalar = _weight("F_y: steering")
    aside_turn: Scalar = _weight("F_y: yaw rate")
    aside_drift: Scalar = _weight("F_y: sideways speed")
    aside_steer_speed: Scalar = _weight("F_y: steering times speed")
    aside_turn_speed: Scalar = _weight("F_y: yaw rate times speed")
    aside_turn_slip: Scalar = _weight("F_y: yaw rate times slip ratio")
    about_one: Scalar = _weight("M_z: constant")
    about_steer: Scalar = _weight("M_z: steering")
    about_turn: Scalar = _weight("M_z: yaw rate")
    about_drift: Scalar = _weight("M_z: sideways speed")
    about_steer_speed: Scalar = _weight("M_z: steering times speed")
    about_turn_speed: Scalar = _weight("M_z: yaw rate times speed")
    about_turn_slip: Scalar = _weight("M_z: yaw rate times slip ratio")
    servo_one: Scalar = _weight("steering rate: constant")
    servo_lead: Scalar = _weight("steering rate: lead of the command")
    servo_angle: Scalar = _weight("steering rate: angle")
    drive_one: Scalar = _weight("wheel acceleration: constant")
    drive_lead: Scalar = _weight("wheel acceleration: lead of the command")
    drive_speed: Scalar = _weight("wheel acceleration: speed")
    drive_lead_speed: Scalar = _weight("wheel acceleration: lead times speed")

    def wrench(self, wrench: "Wrench", forces: "Forces", motion: "Motion", ops: Ops) -> "Wrench":
        """Add what was learned."""
        v, s, r, b, k = scaled(motion, ops)
        ahead = self.ahead_one + self.ahead_speed * v + self.ahead_speed_2 * v * v + self.ahead_steer_2 * s * s
        ahead = ahead + self.ahead_turn_2 * r * r + self.ahead_slip * k + self.ahead_slip_speed * k * v
        aside = self.aside_one + self.aside_steer * s + self.aside_turn * r + self.aside_drift * b
        aside = aside + v * (self.aside_steer_speed * s + self.aside_turn_speed * r) + self.aside_turn_slip * r * k
        about = self.about_one + self.about_steer * s + self.about_turn * r + self.about_drift * b
        about = about + v * (self.about_steer_speed * s + self.about_turn_speed * r) + self.about_turn_slip * r * k
        return self.push(wrench, motion, (ahead, aside, about), ops)

    def steering_rate(self, rate: Scalar, course: "Course", ops: Ops) -> Scalar:
        """Add what was learned of δ̇."""
        servo = course.steering
        lead = ops.tanh((servo.reference - servo.state) / 0.1)
        more = self.servo_one + self.servo_lead * lead + self.servo_angle * ops.tanh(servo.state / 0.2)
        return rate + self.inside(course.motion, ops) * MOST_STEERING * ops.tanh(more / MOST_STEERING)

    def drive_rate(self, rate: Scalar, course: "Course", ops: Ops) -> Scalar:
        """Add what was learned of ω̇."""
        drive = course.drive
        lead, v = ops.tanh(drive.reference - drive.state), ops.tanh(drive.state / 3.0)
        more = self.drive_one + self.drive_lead * lead + self.drive_speed * v + self.drive_lead_speed * lead * v
        return rate + self.inside(course.motion, ops) * MOST_DRIVE * ops.tanh(more / MOST_DRIVE)
