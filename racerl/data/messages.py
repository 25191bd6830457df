"""Message types of bags: the layouts that ROS 2 does not bring along, and where a channel stands in each type.

Types are looked up by name among ROS 2's own and `DEFINITIONS`; what a bag says of its types is never used.
"""

import functools
from typing import Any

POSE_STAMPED = "geometry_msgs/msg/PoseStamped"
POSE_WITH_COVARIANCE = "geometry_msgs/msg/PoseWithCovarianceStamped"
ODOMETRY = "nav_msgs/msg/Odometry"
ACKERMANN = "ackermann_msgs/msg/AckermannDriveStamped"
VESC_STATE = "vesc_msgs/msg/VescStateStamped"
IMU = "sensor_msgs/msg/Imu"
NUMBER = "std_msgs/msg/Float64"

# names and types in their order on the wire (f1tenth/vesc, branch ros2; ros-drivers/ackermann_msgs)
DEFINITIONS = {
    "ackermann_msgs/msg/AckermannDrive": "float32 steering_angle\nfloat32 steering_angle_velocity\nfloat32 speed\n"
    "float32 acceleration\nfloat32 jerk",
    ACKERMANN: "std_msgs/Header header\nackermann_msgs/AckermannDrive drive",
    "vesc_msgs/msg/VescState": "\n".join(
        [
            *(f"float64 {name}" for name in ("temp_fet", "temp_motor", "current_motor", "current_input")),
            *(f"float64 {name}" for name in ("avg_id", "avg_iq", "duty_cycle", "speed", "voltage_input")),
            *(f"float64 {name}" for name in ("charge_drawn", "charge_regen", "energy_drawn", "energy_regen")),
            *(f"int32 {name}" for name in ("displacement", "distance_traveled", "fault_code")),
            "float64 pid_pos_now\nint32 controller_id",
            *(f"float64 {name}" for name in ("ntc_temp_mos1", "ntc_temp_mos2", "ntc_temp_mos3", "avg_vd", "avg_vq")),
        ]
    ),
    VESC_STATE: "std_msgs/Header header\nvesc_msgs/VescState state",
}

_TWIST = {"v_x": "twist.twist.linear.x", "v_y": "twist.twist.linear.y", "yaw_rate": "twist.twist.angular.z"}
_COVARIANT = {"x": "pose.pose.position.x", "y": "pose.pose.position.y", "yaw": "pose.pose.orientation"}
# where a channel stands in a message when its mapping names no field; elsewhere it is `data`
FIELDS = {
    POSE_STAMPED: {"x": "pose.position.x", "y": "pose.position.y", "yaw": "pose.orientation"},
    POSE_WITH_COVARIANCE: _COVARIANT,
    ODOMETRY: {**_COVARIANT, **_TWIST},
    ACKERMANN: {"delta_ref": "drive.steering_angle", "omega_ref": "drive.speed"},
    VESC_STATE: {"omega": "state.speed", "current": "state.current_motor"},
    IMU: {"yaw_rate": "angular_velocity.z"},
}


@functools.lru_cache(maxsize=1)
def typestore() -> Any:
    """Return the known message types, which encode and decode."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    for name, text in DEFINITIONS.items():
        store.register(get_types_from_msg(text, name))
    return store


def usual_field(kind: str, channel: str) -> str:
    """Return where a channel stands in messages of a type."""
    return FIELDS.get(kind, {}).get(channel, "data")


def has_field(kind: str, field: str) -> bool:
    """Return whether messages of a known type have the field, a path of names."""
    for name in field.split("."):
        known = dict(typestore().fielddefs[kind][1]) if kind in typestore().fielddefs else {}
        if name not in known:
            return False
        kind = known[name][1] if isinstance(known[name][1], str) else ""
    return True
