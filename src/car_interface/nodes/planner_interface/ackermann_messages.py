"""ackermann_msgs/AckermannDriveStamped, also where its package isn't installed: Debian has none.

ROS matches messages by type name and MD5, and both follow from names and types of the fields alone. Without the package
the class is made from these, as rosbag makes those of a recording.
"""
from __future__ import annotations

from genpy.message import get_message_class

TYPE = "ackermann_msgs/AckermannDriveStamped"
_FIELDS = f"""Header header
AckermannDrive drive
{"=" * 80}
MSG: std_msgs/Header
uint32 seq
time stamp
string frame_id
{"=" * 80}
MSG: ackermann_msgs/AckermannDrive
float32 steering_angle
float32 steering_angle_velocity
float32 speed
float32 acceleration
float32 jerk
"""


def ackermann_drive_class():
    """Return the message's class: the installed package's, or one from its fields."""
    installed = get_message_class(TYPE)
    if installed is not None:
        return installed
    from genpy.dynamic import generate_dynamic  # here, since it takes memory
    return generate_dynamic(TYPE, _FIELDS)[TYPE]
