"""`python -m racerl.deploy.ros2.node --ros-args --params-file pilot.yaml`: a policy drives, over the usual topics.

Reads a pose (`geometry_msgs/PoseStamped` of a motion capture, or `nav_msgs/Odometry`, whose twist is then used) and the
VESC's state; gives `ackermann_msgs/AckermannDriveStamped` at the rate that the policy was trained at, speed 0 where it
must not drive, and a word on `~/heartbeat` every second. Where the wheels stand the steering's model says: a stock car
measures it not.
"""

import math
import re
import time
from pathlib import Path
from typing import Any

from racerl.deploy.pilot import Guard, Order, Pilot, Sensed
from racerl.deploy.ros2.motion import Velocities
from racerl.interruption import listen

PARAMETERS: dict[str, Any] = {
    "run": "",  # folder of the training
    "delay": 0.0,  # s by which orders act late, on top of what the run's vehicle says
    "latency": 0.0,  # s by which poses are old when they arrive
    "most_speed": 7.0,  # m/s, of the orders: begin slowly
    "pose_topic": "/pose",
    "odometry": False,  # whether that is nav_msgs/Odometry
    "vesc_topic": "/sensors/core",
    "drive_topic": "/drive",
    "speed_to_erpm_gain": 4614.0,  # of vesc.yaml
    # of the pose: where the centre of gravity is, seen from what is tracked
    "forward": 0.0,  # m
    "left": 0.0,  # m
    "guard.stale": 0.2,  # s
    "guard.off_track": 0.1,  # m
    "guard.slow": 2.0,  # control periods
    "guard.settle": 0.5,  # s
}
HEARTBEAT = 1.0  # s


def make_node(pilot_of: Any = Pilot, clock: Any = time.monotonic) -> Any:
    """Return the node; ROS 2 is imported here and nowhere else."""
    from ackermann_msgs.msg import AckermannDriveStamped
    from geometry_msgs.msg import PoseStamped
    from nav_msgs.msg import Odometry
    from rclpy.node import Node
    from rclpy.qos import qos_profile_sensor_data
    from std_msgs.msg import String
    from vesc_msgs.msg import VescStateStamped

    class PilotNode(Node):
        """Latest messages in, an order at every tick out; `clock` is when they arrived, whatever their stamps say."""

        def __init__(self) -> None:
            super().__init__("racerl_pilot")
            given = {name: self.declare_parameter(name, value).value for name, value in PARAMETERS.items()}
            guard = Guard(**{key.removeprefix("guard."): given[key] for key in given if key.startswith("guard.")})
            self.given, self.pilot = (
                given,
                pilot_of(Path(str(given["run"])), float(given["delay"]), guard, float(given["most_speed"])),
            )
            self.velocities, self.arrived = Velocities(), math.nan
            self.moved = (math.nan,) * 6  # x, y, yaw, v_x, v_y, yaw rate
            self.omega = self.wheel_arrived = math.nan
            self.told, self.driven = "", 0
            kind, heard = (Odometry, self.on_odometry) if given["odometry"] else (PoseStamped, self.on_pose)
            self.create_subscription(kind, given["pose_topic"], heard, qos_profile_sensor_data)
            self.create_subscription(VescStateStamped, given["vesc_topic"], self.on_vesc, qos_profile_sensor_data)
            self.drive = self.create_publisher(AckermannDriveStamped, given["drive_topic"], 1)
            self.heartbeat = self.create_publisher(String, "~/heartbeat", 1)
            self.create_timer(self.pilot.period, self.tick)
            self.create_timer(HEARTBEAT, self.beat)

        def on_pose(self, message: Any) -> None:
            """Take a motion capture's pose; velocities come from the latest ones."""
            x, y, yaw = self._placed(message.pose)
            self.arrived = clock()
            self.moved = (x, y, yaw, *self.velocities.add(self.arrived, x, y, yaw))

        def on_odometry(self, message: Any) -> None:
            """Take a pose with its twist, in the car's frame."""
            x, y, yaw = self._placed(message.pose.pose)
            twist = message.twist.twist
            rate = twist.angular.z
            v_x = twist.linear.x - rate * self.given["left"]
            v_y = twist.linear.y + rate * self.given["forward"]
            self.arrived, self.moved = clock(), (x, y, yaw, v_x, v_y, rate)

        def on_vesc(self, message: Any) -> None:
            """Take the wheel's speed."""
            self.omega, self.wheel_arrived = message.state.speed / self.given["speed_to_erpm_gain"], clock()

        def tick(self) -> None:
            """Ask the pilot, and tell the car."""
            now = clock()
            heard = now - self.wheel_arrived <= self.given["guard.stale"]
            measured = self.arrived - self.given["latency"]
            sensed = Sensed(measured, *self.moved, math.nan, self.omega if heard else math.nan)
            order = self.pilot.drive(sensed, now)
            self.driven += not order.why
            if _kind(order.why) != _kind(self.told):  # not at every tick that data grow older
                self.get_logger().warning(f"standing: {order.why}" if order.why else "driving")
            self.told = order.why
            self.drive.publish(self._message(order))

        def beat(self) -> None:
            """Say once a second what goes on."""
            self.heartbeat.publish(String(data=self.told or f"driving, {self.driven} orders so far"))

        def _message(self, order: Order) -> Any:
            message = AckermannDriveStamped()
            message.header.stamp = self.get_clock().now().to_msg()
            message.drive.steering_angle = order.delta_ref
            message.drive.speed = order.drive_ref
            return message

        def _placed(self, pose: Any) -> tuple[float, float, float]:
            """Return where the centre of gravity is, and the heading."""
            q = pose.orientation
            yaw = math.atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z))
            forward, left, cosine, sine = self.given["forward"], self.given["left"], math.cos(yaw), math.sin(yaw)
            x = pose.position.x + forward * cosine - left * sine
            return x, pose.position.y + forward * sine + left * cosine, yaw

    return PilotNode()


def _kind(why: str) -> str:
    return re.sub(r"-?[\d.]+", "", why)


def main() -> None:
    """Spin the node until it is asked to end, or fails; then tell the car to stand."""
    import rclpy
    from rclpy.signals import SignalHandlerOptions

    # rclpy's own handlers close the context, and then nothing more can be told
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    listen()
    node = make_node()
    try:
        rclpy.spin(node)
    except KeyboardInterrupt:
        node.get_logger().warning("standing: asked to end")
    finally:
        node.drive.publish(node._message(Order(0.0, 0.0, "ended")))
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
