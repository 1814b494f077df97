"""Units and conversions that several parts use: nanoseconds, the stamps of messages, the yaw of an orientation.

Messages are taken by their fields, so that those of rospy and those of rosbags both do. Pure, and without ``typing``,
which would cost the guard of the servo board 2 MB.
"""
from __future__ import annotations

import math

NS_PER_MS = 1_000_000
NS_PER_S = 1_000_000_000


def stamp_ns(stamp) -> int:
    """A message's time or duration in nanoseconds.

    Args:
        stamp: with the fields ``secs`` and ``nsecs``, as rospy has them, or ``sec`` and ``nanosec``, as rosbags and
            ROS 2 have them.
    """
    if hasattr(stamp, "secs"):
        return stamp.secs * NS_PER_S + stamp.nsecs
    return stamp.sec * NS_PER_S + stamp.nanosec


def yaw_rad(orientation) -> float:
    """The yaw of a quaternion with the fields x, y, z and w: rad, −π to π, counterclockwise positive (REP-103)."""
    x, y, z, w = orientation.x, orientation.y, orientation.z, orientation.w
    return math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
